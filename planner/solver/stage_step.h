/* One SQP iteration after the other: linearise all stages, solve the QP, take the full step. */

#include <time.h>

typedef struct {
    Qp qp;
    vec information[GROUPS], curvature[GROUPS][CURVED * CURVED + 1];
} Work;

typedef struct {
    int32_t status, iterations, qp_iterations, reserved;
    int64_t linearise_ns, qp_ns;
    double step;
} Report;

static int64_t cpu_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

/* entries of W stages from `k` on; lanes beyond the horizon repeat the last stage */
static inline vec lanes(const double *from, int stride, int k)
{
    if (k + W > N) {
        vec v = all(0.0);
        for (int l = 0; l < W; l++) ((double *)&v)[l] = from[(k + l < N ? k + l : N - 1) * stride];
        return v;
    }
    return gathered(from + k * stride, stride);
}

/* stages beyond the horizon ask for nothing */
static void quiet_lanes(Qp *q)
{
    for (int k = N; k < GROUPS * W; k++)
        for (int e = 0; e < ELEMENTS; e++) ((double *)&q->data[k / W][e])[k % W] = neutral[e];
}

static void linearise(Work *w, const double *z, const double *du, const double *stages, const double *common,
                      const double *multiplier)
{
SHARED
    for (int g = 0; g < GROUPS; g++) {
        const int k = g * W;
        vec *d = w->qp.data[g], *info = &w->information[g], *curved = w->curvature[g];
        vec before[NX], change[NU], after[NX], stage[STAGE];
        for (int i = 0; i < NX; i++) before[i] = lanes(z + i, NX, k);
        for (int i = 0; i < NX; i++) after[i] = lanes(z + NX + i, NX, k);
        for (int i = 0; i < NU; i++) change[i] = lanes(du + i, NU, k);
        for (int i = 0; i < STAGE; i++) stage[i] = lanes(stages + i, STAGE, k);
        for (int i = 0; i < COUPLED; i++) stage[coupled_at[i]] = lanes(multiplier + coupled_row[i], ROWS, k);
        (void)info, (void)curved, (void)before, (void)change, (void)after, (void)stage;
EACH_GROUP
    }
    quiet_lanes(&w->qp);
}

/* Nearest positive semi-definite matrices of the exact information Hessians, added to Q: cyclic Jacobi rotations,
   W stages at a time; four sweeps leave 1e-12 of a matrix of five rows, six are made. */
static void add_projected(Work *w)
{
#if PROJECTED
    for (int g = 0; g < GROUPS; g++) {
        vec a[CURVED][CURVED], v[CURVED][CURVED];
        for (int i = 0; i < CURVED; i++)
            for (int j = 0; j < CURVED; j++) {
                a[i][j] = w->curvature[g][j * CURVED + i];
                v[i][j] = all(i == j ? 1.0 : 0.0);
            }
        for (int sweep = 0; sweep < 6; sweep++)
            for (int p = 0; p < CURVED - 1; p++)
                for (int r = p + 1; r < CURVED; r++) {
                    const vec off = a[p][r], gap = 0.5 * (a[r][r] - a[p][p]);
                    const vec root = v_sqrt(gap * gap + off * off);
                    const vec sign = pick(TRUE_IF(gap < 0.0), all(-1.0), all(1.0));
                    const vec below = gap + sign * root;
                    const vec t = keep(TRUE_IF(below != 0.0), off / pick(TRUE_IF(below != 0.0), below, all(1.0)));
                    const vec c = 1.0 / v_sqrt(1.0 + t * t), s = t * c;
                    for (int i = 0; i < CURVED; i++) {
                        const vec x = a[i][p], y = a[i][r];
                        a[i][p] = c * x - s * y;
                        a[i][r] = s * x + c * y;
                    }
                    for (int i = 0; i < CURVED; i++) {
                        const vec x = a[p][i], y = a[r][i], m = v[i][p], n = v[i][r];
                        a[p][i] = c * x - s * y;
                        a[r][i] = s * x + c * y;
                        v[i][p] = c * m - s * n;
                        v[i][r] = s * m + c * n;
                    }
                }
        for (int i = 0; i < CURVED; i++)
            for (int j = 0; j <= i; j++) {
                vec sum = all(0.0);
                for (int e = 0; e < CURVED; e++) sum += v[i][e] * v[j][e] * v_max(a[e][e], all(0.0));
                w->qp.data[g][curved_at[i][j]] += sum;
            }
    }
#else
    (void)w;
#endif
}

static void copy_solution(const Qp *q, double *dz, double *du, double *multiplier)
{
    for (int k = 0; k < N; k++) {
        const Group *p = &q->group[k / W];
        for (int i = 0; i < NX; i++) dz[k * NX + i] = ((const double *)&p->z[i])[k % W];
        for (int i = 0; i < NU; i++) du[k * NU + i] = ((const double *)&p->u[i])[k % W];
        for (int i = 0; i < ROWS; i++)
            multiplier[k * ROWS + i] = upper_side[i] < 0 ? 0.0 : ((const double *)&p->lam[upper_side[i]])[k % W];
    }
}

size_t work_size(void) { return sizeof(Work); }

void forget(Work *w) { w->qp.warm = COLD; }

/* The last solution's multipliers one stage on; the last stage keeps its own. */
void shift(Work *w)
{
    for (int k = 0; k + 1 < N; k++)
        for (int c = 0; c < SIDES; c++)
            ((double *)&w->qp.kept[k / W][c])[k % W] = ((double *)&w->qp.kept[(k + 1) / W][c])[(k + 1) % W];
}

/* Blocks of a `StageQp` in, solution out: arrays in the order of `pattern.ARRAYS`, then dz, du, multiplier. */
int32_t solve_blocks(Work *w, double *const *arrays, int32_t *iterations)
{
    for (int e = 0; e < ELEMENTS; e++)
        for (int k = 0; k < N; k++)
            ((double *)&w->qp.data[k / W][e])[k % W] = arrays[place[e].array][k * place[e].stride + place[e].at];
    quiet_lanes(&w->qp);
    const int status = solve_packed(&w->qp);
    *iterations = w->qp.iterations;
    copy_solution(&w->qp, arrays[BLOCKS], arrays[BLOCKS + 1], arrays[BLOCKS + 2]);
    return status;
}

/* Blocks of the QP at a guess, for another solver; information and its Hessian (CURVED^2, N) where there are any. */
void write_blocks(Work *w, const double *z, const double *du, const double *stages, const double *common,
                  const double *multiplier, double *const *arrays, double *information, double *curvature)
{
    linearise(w, z, du, stages, common, multiplier);
    for (int k = 0; k < N; k++) {
        for (int e = 0; e < ELEMENTS; e++) {
            const double x = ((double *)&w->qp.data[k / W][e])[k % W];
            double *block = arrays[place[e].array];
            if (!block) continue;
            block[k * place[e].stride + place[e].at] = x;
            block[k * place[e].stride + place[e].twin] = x;
        }
        information[k] = ((double *)&w->information[k / W])[k % W];
        for (int i = 0; i < CURVED * CURVED; i++)
            curvature[k * CURVED * CURVED + i] = ((double *)&w->curvature[k / W][i])[k % W];
    }
}

/* `iterations` SQP iterations on the guess z (NX, N+1), du (NU, N), multiplier (ROWS, N), all three in place; ends
   early, with the guess as far as it came, at a QP that is not solved. */
void iterate_sqp(Work *w, int32_t iterations, double *z, double *du, const double *stages, const double *common,
                 double *multiplier, double *information, Report *report)
{
    double dz[N * NX], change[N * NU], price[N * ROWS + 1];
    memset(report, 0, sizeof *report);
    for (int m = 0; m < iterations && report->status == SOLVED; m++) {
        const int64_t start = cpu_ns();
        linearise(w, z, du, stages, common, multiplier);
        add_projected(w);
        const int64_t middle = cpu_ns();
        report->status = solve_packed(&w->qp);
        report->qp_iterations += w->qp.iterations;
        report->linearise_ns += middle - start;
        if (report->status == SOLVED) {
            copy_solution(&w->qp, dz, change, price);
            memcpy(multiplier, price, N * ROWS * sizeof *multiplier);
            report->iterations++;
            report->step = 0.0;
            for (int i = 0; i < N * NX; i++) z[NX + i] += dz[i];
            for (int i = 0; i < N * NU; i++) {
                du[i] += change[i];
                const double size = fabs(change[i]) / change_bound[i % NU];
                if (size > report->step) report->step = size;
            }
        }
        report->qp_ns += cpu_ns() - middle;
    }
    for (int k = 0; k < N; k++) information[k] = ((double *)&w->information[k / W])[k % W];
}

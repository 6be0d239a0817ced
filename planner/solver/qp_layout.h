/* Primal-dual interior point for one QP of `qp.StageQp`'s form (Mehrotra, SIAM J. Optim. 2, 1992), on generated
   linear algebra. Inequalities are value + t = bound; a soft one is value - s + t = bound with s >= 0 and cost
   l1 s + l2 s^2 / 2, s and its multiplier eliminated. Motion holds exactly from the first iterate on, so that what a
   step has to bring down is complementarity, the gap of the inequalities and the gradient in the inputs. */

#if W > 1
#define LANE(v, l) ((v)[l])
#else
#define LANE(v, l) (v)
#endif
#define STORE(place, value) for (int l = 0; l < W; l++) place = LANE(value, l);
#define COUNT ((double)(SIDES + SOFT) * GROUPS * W)

enum { SOLVED = 0, ITERATION_LIMIT = 1, SMALL_STEP = 2, NOT_FINITE = 3 };
enum { COLD = 0, WARM = 1 };

static const int most_iterations[] = {[COLD] = 40, [WARM] = 20}; /* a warm start that takes more is no help */

#define TOLERANCE 1e-4   /* of complementarity, inequalities and gradient, as HPIPM's */
#define BOUNDARY 0.999   /* share of the way to the boundary */
#define SMALLEST_STEP 1e-6
#define COLD_MU 10.0
#define WARM_MU 1e-2
#define LEAST_GAP 1e-3   /* of an inequality at a cold start */

typedef struct {
    double K[NU][V * W], L[NU][NU], inverse[NU];
} __attribute__((aligned(64))) Feedback;

typedef struct {
    vec z[NX], u[NU], dz[NX], du[NU], gz[NX], gu[NU];
    vec t[SIDES], lam[SIDES], gap[SIDES], inv[SIDES], weight[SIDES], pull[SIDES], extra[SIDES], dt[SIDES], dlam[SIDES];
    vec s[SOFT + 1], mu[SOFT + 1], invs[SOFT + 1], share[SOFT + 1], extras[SOFT + 1], ds[SOFT + 1], dmu[SOFT + 1];
} Group;

typedef double Hessian[NX * V * W] __attribute__((aligned(64)));
typedef double Corner[NU * (NU + 1) / 2];

typedef struct {
    vec data[GROUPS][ELEMENTS];
    Group group[GROUPS];
    vec kept[GROUPS][SIDES]; /* multipliers of the last solution */
    Hessian H[GROUPS * W];
    Corner R[GROUPS * W];
    double AB[GROUPS * W][NAB], b[GROUPS * W][NX];
    double gz[GROUPS * W][NX], gu[GROUPS * W][NU], dz[GROUPS * W][NX], du[GROUPS * W][NU], ff[GROUPS * W][NU];
    Feedback feedback[GROUPS * W];
    int warm, iterations;
} Qp;

static inline vec gathered(const double *from, int stride)
{
#if W == 4
    return (vec){from[0], from[stride], from[2 * stride], from[3 * stride]};
#else
    vec v = all(0.0);
    for (int l = 0; l < W; l++) ((double *)&v)[l] = from[l * stride];
    return v;
#endif
}
static double largest(vec v)
{
    double most = LANE(v, 0);
    for (int l = 1; l < W; l++) most = LANE(v, l) > most || LANE(v, l) != LANE(v, l) ? LANE(v, l) : most;
    return most;
}
static double total(vec v)
{
    double sum = 0.0;
    for (int l = 0; l < W; l++) sum += LANE(v, l);
    return sum;
}

/* t[row][v] = columns of g as rows: W x W blocks turned */
static inline void turn(const vec *a, int step, vec *to, int to_step)
{
#if W == 4
    const vec p = __builtin_shuffle(a[0], a[step], (mask){0, 4, 2, 6});
    const vec q = __builtin_shuffle(a[0], a[step], (mask){1, 5, 3, 7});
    const vec r = __builtin_shuffle(a[2 * step], a[3 * step], (mask){0, 4, 2, 6});
    const vec s = __builtin_shuffle(a[2 * step], a[3 * step], (mask){1, 5, 3, 7});
    to[0] = __builtin_shuffle(p, r, (mask){0, 1, 4, 5});
    to[to_step] = __builtin_shuffle(q, s, (mask){0, 1, 4, 5});
    to[2 * to_step] = __builtin_shuffle(p, r, (mask){2, 3, 6, 7});
    to[3 * to_step] = __builtin_shuffle(q, s, (mask){2, 3, 6, 7});
#else
    for (int i = 0; i < W; i++)
        for (int j = 0; j < W; j++) ((double *)&to[i * to_step])[j] = ((const double *)&a[j * step])[i];
#endif
}
static inline void transpose(vec (*g)[V], vec (*t)[V])
{
    for (int c = 0; c < V; c++)
        for (int v = 0; v < V; v++) turn(&g[c * W][v], V, &t[v * W][c], V);
}
static inline void mirror(vec (*P)[V])
{
    for (int c = 0; c < V; c++)
        for (int v = c + 1; v < V; v++) turn(&P[c * W][v], V, &P[v * W][c], V);
}

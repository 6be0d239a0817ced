/* The iterations; see qp_layout.h for the method. */

typedef struct { double mu, complementarity, gap; } Residual;

/* A, B, b of each stage by itself, for the recursions */
static void spread_motion(Qp *q)
{
    for (int g = 0; g < GROUPS; g++) {
        for (int e = 0; e < NAB; e++) STORE(q->AB[g * W + l][e], q->data[g][e]);
        for (int i = 0; i < NX; i++) STORE(q->b[g * W + l][i], q->data[g][NAB + i]);
    }
}

static void gather_step(Qp *q)
{
    for (int g = 0; g < GROUPS; g++) {
        for (int i = 0; i < NX; i++) q->group[g].dz[i] = gathered(&q->dz[g * W][i], NX);
        for (int i = 0; i < NU; i++) q->group[g].du[i] = gathered(&q->du[g * W][i], NU);
    }
}

/* inputs unchanged, states as the motion has them */
static void start_motion(Qp *q)
{
    const double nothing[NX] = {0};
    for (int k = 0; k < N; k++) roll(q->AB[k], q->b[k], k ? q->dz[k - 1] : nothing, q->dz[k]);
    memset(q->du, 0, sizeof q->du);
    gather_step(q);
    for (int g = 0; g < GROUPS; g++) {
        memcpy(q->group[g].z, q->group[g].dz, sizeof q->group[g].z);
        memset(q->group[g].u, 0, sizeof q->group[g].u);
    }
}

/* Slacks and multipliers on the central path of `mu`, as far as the inequalities at (z, u) allow, or pulled there
   from the multipliers of the last solution. */
static void start_sides(Qp *q, double mu, int warm)
{
    for (int g = 0; g < GROUPS; g++) {
        Group *p = &q->group[g];
        const vec *d = q->data[g];
        vec value[SIDES], bound[SIDES];
        side_values(d, p->z, p->u, value);
        side_bounds(d, bound);
        for (int c = 0; c < HARD; c++) {
            const vec room = bound[c] - value[c];
            const vec least = warm ? all(1e-8) : all(LEAST_GAP);
            vec t = v_max(room, least), lam = mu / t;
            if (warm) {
                lam = v_max(q->kept[g][c], lam * 0.1);
                lam = v_min(lam, mu / all(1e-8));
                t = v_max(t, mu / lam);
            }
            p->t[c] = t;
            p->lam[c] = lam;
        }
        for (int j = 0; j < SOFT; j++) {
            const int c = HARD + j;
            const vec l1 = d[SLACK_L1 + soft_row[j]], l2 = d[SLACK_L2 + soft_row[j]];
            const vec over = value[c] - bound[c], positive = v_max(over, all(0.0));
            const vec price = l1 + l2 * positive;
            const vec room = 2.0 * mu / (price + v_sqrt(price * price + 4.0 * mu * l2));
            /* half the excess more than needed: close to one of its two boundaries, a start takes long to come away */
            vec s = 1.5 * positive + room, t = s - over, top = l1 + l2 * s, lam;
            if (warm) {
                lam = v_min(v_max(q->kept[g][c], 0.1 * mu / t), top - v_min(0.1 * mu / s, 0.5 * top));
                t = v_max(t, mu / lam);
                s = v_max(s, mu / (top - lam));
                top = l1 + l2 * s;
            } else {
                lam = pick(TRUE_IF(over > 0.0), 0.5 * top, v_min(mu / t, 0.5 * top));
            }
            p->s[j] = s;
            p->t[c] = t;
            p->lam[c] = lam;
            p->mu[j] = top - lam;
        }
    }
}

/* Residuals, weights of the sides, condensed Hessians and gradients for the affine step. */
static Residual prepare(Qp *q)
{
    vec sum = all(0.0), most = all(0.0), worst = all(0.0);
    for (int g = 0; g < GROUPS; g++) {
        Group *p = &q->group[g];
        const vec *d = q->data[g];
        vec value[SIDES], bound[SIDES];
        side_values(d, p->z, p->u, value);
        side_bounds(d, bound);
        for (int c = 0; c < HARD; c++) {
            p->gap[c] = value[c] + p->t[c] - bound[c];
            p->inv[c] = 1.0 / p->t[c];
            p->weight[c] = p->lam[c] * p->inv[c];
            p->pull[c] = p->weight[c] * p->gap[c];
        }
        for (int j = 0; j < SOFT; j++) {
            const int c = HARD + j;
            const vec l1 = d[SLACK_L1 + soft_row[j]], l2 = d[SLACK_L2 + soft_row[j]];
            p->gap[c] = value[c] - p->s[j] + p->t[c] - bound[c];
            p->inv[c] = 1.0 / p->t[c];
            p->invs[j] = 1.0 / p->s[j];
            const vec w = p->lam[c] * p->inv[c], v = l2 + p->mu[j] * p->invs[j];
            p->share[j] = 1.0 / (v + w);
            p->weight[c] = w * v * p->share[j];
            p->pull[c] = p->weight[c] * p->gap[c] + w * p->share[j] * (l1 + l2 * p->s[j]);
            const vec product = p->s[j] * p->mu[j];
            sum += product;
            most = v_max(most, product);
        }
        for (int c = 0; c < SIDES; c++) {
            const vec product = p->t[c] * p->lam[c];
            sum += product;
            most = v_max(most, product);
            worst = v_max(worst, v_abs(p->gap[c]));
        }
        cost_gradient(d, p->z, p->u, p->gz, p->gu);
    }
    return (Residual){total(sum) / COUNT, largest(most), largest(worst)};
}

static void condense(Qp *q)
{
    for (int g = 0; g < GROUPS; g++) {
        Group *p = &q->group[g];
        condensed(q->data[g], p->weight, g * W, q->H, q->R);
        side_adjoint(q->data[g], p->pull, p->gz, p->gu);
        for (int i = 0; i < NX; i++) STORE(q->gz[g * W + l][i], p->gz[i]);
        for (int i = 0; i < NU; i++) STORE(q->gu[g * W + l][i], p->gu[i]);
    }
}

/* Largest gradient in the inputs once the multipliers of the motion have taken up that in the states */
static double gradient_left(Qp *q)
{
    double p[NX] = {0}, left[NU], most = 0.0;
    for (int g = 0; g < GROUPS; g++) {
        Group *at = &q->group[g];
        vec gz[NX], gu[NU];
        memcpy(gz, at->gz, sizeof gz);
        memcpy(gu, at->gu, sizeof gu);
        side_adjoint(q->data[g], at->lam, gz, gu);
        for (int i = 0; i < NX; i++) STORE(q->gz[g * W + l][i], gz[i]);
        for (int i = 0; i < NU; i++) STORE(q->gu[g * W + l][i], gu[i]);
    }
    const double none[NX] = {0};
    for (int i = 0; i < NX; i++) p[i] = q->gz[N - 1][i];
    for (int k = N - 1; k >= 0; k--) {
        costate(q->AB[k], k ? q->gz[k - 1] : none, q->gu[k], p, left);
        for (int i = 0; i < NU; i++) most = fabs(left[i]) > most || left[i] != left[i] ? fabs(left[i]) : most;
    }
    return most;
}

static int factorise(Qp *q)
{
    vec P[V * W][V];
    for (int j = 0; j < NX; j++)
        for (int v = 0; v < V; v++) P[j][v] = ((vec *)q->H[N - 1])[j * V + v];
    for (int k = N - 1; k >= 0; k--) {
        mirror(P);
        if (!factor(q->AB[k], q->R[k], P, &q->feedback[k])) return 0;
        if (k == 0) break;
        for (int j = 0; j < NX; j++)
            for (int v = j / W; v < V; v++) P[j][v] += ((vec *)q->H[k - 1])[j * V + v];
    }
    return 1;
}

static void solve_step(Qp *q)
{
    const double nothing[NX] = {0};
    double p[NX];
    memcpy(p, q->gz[N - 1], sizeof p);
    for (int k = N - 1; k >= 0; k--)
        backward(q->AB[k], &q->feedback[k], k ? q->gz[k - 1] : nothing, q->gu[k], p, q->ff[k]);
    for (int k = 0; k < N; k++)
        forward(q->AB[k], &q->feedback[k], q->ff[k], k ? q->dz[k - 1] : nothing, q->du[k], q->dz[k]);
    gather_step(q);
}

/* Steps of slacks and multipliers that belong to (dz, du), aiming at products `target` - `extra`; returns the
   largest rate at which one of them goes to zero, and in `sums` those of (t dlam + lam dt) and of dt dlam. */
static double recover(Qp *q, double target, int corrected, double *sums)
{
    vec rate = all(0.0), first = all(0.0), second = all(0.0);
    for (int g = 0; g < GROUPS; g++) {
        Group *p = &q->group[g];
        const vec *d = q->data[g];
        vec value[SIDES];
        side_values(d, p->dz, p->du, value);
        for (int c = 0; c < SIDES; c++) {
            vec e = all(0.0), dt = -p->gap[c] - value[c], dlam;
            if (corrected) e = (target - p->extra[c]) * p->inv[c];
            if (c < HARD) {
                dlam = p->pull[c] - p->lam[c] + e + p->weight[c] * value[c];
            } else {
                const int j = c - HARD;
                const vec l1 = d[SLACK_L1 + soft_row[j]], l2 = d[SLACK_L2 + soft_row[j]];
                vec es = all(0.0);
                if (corrected) es = (target - p->extras[j]) * p->invs[j];
                const vec w = p->lam[c] * p->inv[c];
                const vec base = e + es - l1 - l2 * p->s[j];
                const vec ds = p->share[j] * (base + w * (p->gap[c] + value[c]));
                dt += ds;
                dlam = e - p->lam[c] - w * dt;
                const vec dmu = es - p->mu[j] - p->mu[j] * p->invs[j] * ds;
                p->ds[j] = ds;
                p->dmu[j] = dmu;
                rate = v_max(rate, v_max(-ds * p->invs[j], -dmu / p->mu[j]));
                first += p->s[j] * dmu + p->mu[j] * ds;
                second += ds * dmu;
            }
            p->dt[c] = dt;
            p->dlam[c] = dlam;
            rate = v_max(rate, v_max(-dt * p->inv[c], -dlam / p->lam[c]));
            first += p->t[c] * dlam + p->lam[c] * dt;
            second += dt * dlam;
        }
    }
    sums[0] = total(first) / COUNT;
    sums[1] = total(second) / COUNT;
    return largest(rate);
}

/* Gradients for the step that aims at `target` and makes up for the second order of the affine one */
static void correct(Qp *q, double target)
{
    for (int g = 0; g < GROUPS; g++) {
        Group *p = &q->group[g];
        const vec *d = q->data[g];
        vec y[SIDES];
        for (int c = 0; c < SIDES; c++) {
            p->extra[c] = p->dt[c] * p->dlam[c];
            y[c] = (target - p->extra[c]) * p->inv[c];
        }
        for (int j = 0; j < SOFT; j++) {
            const int c = HARD + j;
            p->extras[j] = p->ds[j] * p->dmu[j];
            const vec v = d[SLACK_L2 + soft_row[j]] + p->mu[j] * p->invs[j], w = p->lam[c] * p->inv[c];
            y[c] = p->share[j] * (v * y[c] - w * (target - p->extras[j]) * p->invs[j]);
        }
        side_adjoint(d, y, p->gz, p->gu);
        for (int i = 0; i < NX; i++) STORE(q->gz[g * W + l][i], p->gz[i]);
        for (int i = 0; i < NU; i++) STORE(q->gu[g * W + l][i], p->gu[i]);
    }
}

static void take(Qp *q, double step)
{
    for (int g = 0; g < GROUPS; g++) {
        Group *p = &q->group[g];
        for (int i = 0; i < NX; i++) p->z[i] += step * p->dz[i];
        for (int i = 0; i < NU; i++) p->u[i] += step * p->du[i];
        for (int c = 0; c < SIDES; c++) {
            p->t[c] += step * p->dt[c];
            p->lam[c] += step * p->dlam[c];
        }
        for (int j = 0; j < SOFT; j++) {
            p->s[j] += step * p->ds[j];
            p->mu[j] += step * p->dmu[j];
        }
    }
}

static double bounded_step(double rate, double share)
{
    return rate * 1.0 > share ? share / rate : 1.0;
}

static int iterate(Qp *q, int limit)
{
    for (int k = 0; ; k++) {
        const Residual r = prepare(q);
        if (!isfinite(r.mu) || !isfinite(r.gap)) return NOT_FINITE;
        if (r.complementarity <= TOLERANCE && r.gap <= TOLERANCE && gradient_left(q) <= TOLERANCE) return SOLVED;
        if (k == limit) return ITERATION_LIMIT;
        q->iterations++;
        condense(q);
        if (!factorise(q)) return NOT_FINITE;
        double sums[2];
        solve_step(q);
        const double affine = bounded_step(recover(q, 0.0, 0, sums), 1.0);
        const double ahead = (r.mu + affine * (sums[0] + affine * sums[1])) / r.mu;
        correct(q, ahead * ahead * ahead * r.mu);
        solve_step(q);
        const double step = bounded_step(recover(q, ahead * ahead * ahead * r.mu, 1, sums), BOUNDARY);
        if (!(step > SMALLEST_STEP)) return isfinite(step) ? SMALL_STEP : NOT_FINITE;
        take(q, step);
    }
}

static int finite_solution(const Qp *q)
{
    vec sum = all(0.0);
    for (int g = 0; g < GROUPS; g++) {
        for (int i = 0; i < NX; i++) sum += v_abs(q->group[g].z[i]);
        for (int i = 0; i < NU; i++) sum += v_abs(q->group[g].u[i]);
    }
    return isfinite(total(sum));
}

static void keep_multipliers(Qp *q)
{
    for (int g = 0; g < GROUPS; g++) memcpy(q->kept[g], q->group[g].lam, sizeof q->kept[g]);
}

/* From the multipliers of the last solution, and if that fails afresh. */
static int solve_packed(Qp *q)
{
    int status = ITERATION_LIMIT;
    q->iterations = 0;
    spread_motion(q);
    for (int warm = q->warm; warm >= COLD; warm--) {
        start_motion(q);
        start_sides(q, warm ? WARM_MU : COLD_MU, warm);
        status = iterate(q, most_iterations[warm]);
        if (status == SOLVED && !finite_solution(q)) status = NOT_FINITE;
        if (status == SOLVED) break;
    }
    q->warm = status == SOLVED;
    if (q->warm) keep_multipliers(q);
    return status;
}

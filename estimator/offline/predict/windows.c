/* The predictor of `propagate` and `innovations` on windows side by side, W of them in one vector of doubles.

   The same steps in the same order as the numpy code beside it, which says what they are and is used where there is no
   compiler. Arrays are as there: matrices of samples have the sample last, maps of a step have it first. Every
   function returns 1, or 0 where it found no working memory. */

#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#define W 4   /* one register of AVX2; of wider vectors GCC keeps every sum of a matrix in memory */
#define TILE 32 /* blocks that `arrange` moves at once: what it writes stays in the first-level cache */
typedef double vec __attribute__((vector_size(8 * W)));
typedef ptrdiff_t size;

static inline vec load(const double *at) { vec v; memcpy(&v, at, sizeof v); return v; }
static inline void store(double *at, vec v) { memcpy(at, &v, sizeof v); }
static inline vec all(double x) { return x - (vec){0}; }

/* c = a b, 3 by 3 times 3 by 3, row by row. */
static inline void product(const vec *a, const vec *b, vec *c)
{
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            c[3 * i + k] = a[3 * i] * b[k] + a[3 * i + 1] * b[3 + k] + a[3 * i + 2] * b[6 + k];
}

/* c = a b, 2 by 3 times 3 by 3. */
static inline void product_2(const vec *a, const vec *b, vec *c)
{
    for (int i = 0; i < 2; i++)
        for (int k = 0; k < 3; k++)
            c[3 * i + k] = a[3 * i] * b[k] + a[3 * i + 1] * b[3 + k] + a[3 * i + 2] * b[6 + k];
}

/* `count` entries of a matrix, `stride` apart. */
static inline void fetch(const double *at, size stride, int count, vec *m)
{
    for (int i = 0; i < count; i++) m[i] = load(at + i * stride);
}

static inline void put(double *at, size stride, int count, const vec *m)
{
    for (int i = 0; i < count; i++) store(at + i * stride, m[i]);
}

/* First sample of each vector: the last one ends with the last sample and may repeat some. */
#define EACH_VECTOR(s, n) for (size s = 0, next_ = 0; next_ < (n); next_ += W, s = next_ + W > (n) ? (n) - W : next_)

/* Series of `order` terms for a (3, 3, n) of a fraction of a block, then doubled: e^a, its first and second integral. */
int exponentials(size n, size order, size doublings, const double *a, double *decay, double *first, double *second)
{
    EACH_VECTOR(s, n) {
        vec A[9], power[9], next[9], d[9], f[9], g[9];
        fetch(a + s, n, 9, A);
        for (int i = 0; i < 9; i++) {
            double one = i % 4 == 0;
            power[i] = d[i] = f[i] = all(one), g[i] = all(0.5 * one);
        }
        double factorial = 1.0;
        for (int j = 1; j < order; j++) {
            product(power, A, next);
            factorial *= j;
            double by_d = 1.0 / factorial, by_f = by_d / (j + 1), by_g = by_f / (j + 2);
            for (int i = 0; i < 9; i++) {
                power[i] = next[i];
                d[i] += power[i] * by_d;
                f[i] += power[i] * by_f;
                g[i] += power[i] * by_g;
            }
        }
        for (int doubling = 0; doubling < doublings; doubling++) {
            vec longer[9];
            product(f, f, next);
            for (int i = 0; i < 9; i++) {
                g[i] = (next[i] + 2.0 * g[i]) / 4.0;
                longer[i] = d[i] + (i % 4 == 0);
            }
            product(f, longer, next);
            for (int i = 0; i < 9; i++) f[i] = next[i] / 2.0;
            product(d, d, next);
            memcpy(d, next, sizeof d);
        }
        put(decay + s, n, 9, d), put(first + s, n, 9, f), put(second + s, n, 9, g);
    }
    return 1;
}

/* Gains (3, 3 signals, blocks, windows) of the motion signals in turn, and the variance (5, blocks, windows) of all
   predicted signals relative to the noise's. */
int riccati(size blocks, size windows, const double *H, const double *A, const double *F, const double *variance,
            const double *walk, const double *start, double *gains, double *ratio)
{
    size n = blocks * windows;
    EACH_VECTOR(w, windows) {
        vec P[9];
        for (int i = 0; i < 9; i++) P[i] = all(i % 4 == 0 ? start[i / 4] * start[i / 4] : 0.0);
        for (size b = 0; b < blocks; b++) {
            size s = b * windows + w;
            vec h[9], step[9], moved[9], f[6], felt[6], after[6];
            fetch(H + s, n, 9, h), fetch(A + s, n, 9, step), fetch(F + s, n, 6, f);
            for (int i = 0; i < 3; i++) {
                const vec *row = h + 3 * i;
                vec seen[3], gain[3];
                for (int k = 0; k < 3; k++)
                    seen[k] = P[3 * k] * row[0] + P[3 * k + 1] * row[1] + P[3 * k + 2] * row[2];
                vec innovation = seen[0] * row[0] + seen[1] * row[1] + seen[2] * row[2] + variance[2 + i];
                for (int k = 0; k < 3; k++) {
                    gain[k] = seen[k] / innovation;
                    store(gains + (3 * k + i) * n + s, gain[k]);
                }
                store(ratio + (2 + (i + 1) % 3) * n + s, innovation / variance[2 + i]);
                for (int k = 0; k < 3; k++)
                    for (int l = 0; l < 3; l++) P[3 * k + l] -= gain[k] * seen[l];
            }
            product_2(f, h, felt), product_2(felt, P, after);
            for (int i = 0; i < 2; i++) {
                const vec *x = felt + 3 * i, *y = after + 3 * i;
                store(ratio + i * n + s, 1.0 + (x[0] * y[0] + x[1] * y[1] + x[2] * y[2]) / variance[i]);
            }
            product(step, P, moved);
            for (int i = 0; i < 3; i++)
                for (int k = 0; k < 3; k++)
                    P[3 * i + k] = moved[3 * i] * step[3 * k] + moved[3 * i + 1] * step[3 * k + 1]
                                 + moved[3 * i + 2] * step[3 * k + 2] + (i == k ? walk[i] : 0.0);
        }
    }
    return 1;
}

/* One row of `maps`: by the state error, its change, the forces and the motion that were measured. */
static inline void row(double *step, int at, vec factor, const vec *error, const vec *change, const vec *motion)
{
    for (int k = 0; k < 3; k++) {
        vec e = factor * error[k], c = factor * change[k], m = factor * motion[k];
        for (int l = 0; l < W; l++) {
            double *to = step + 88 * l + 11 * at;
            to[k] = e[l], to[3 + k] = c[l], to[8 + k] = m[l];
        }
    }
}

/* Maps (blocks, windows, 8, 11) of a block; `weight` (5, blocks, windows). */
int maps(size blocks, size windows, const double *H, const double *G, const double *A, const double *F,
         const double *gains, const double *weight, double *maps)
{
    static const int ROW[3] = {3, 4, 2};
    size n = blocks * windows;
    for (size b = 0; b < blocks; b++) EACH_VECTOR(w, windows) {
        size s = b * windows + w;
        double *step = maps + 88 * s;
        memset(step, 0, 88 * W * sizeof *step);
        vec h[9], g[9], a[9], f[6], K[9], L[9], T[9], KT[9], by[9], by_g[9], corrected[6], felt[6], felt_h[6], felt_g[6];
        fetch(H + s, n, 9, h), fetch(G + s, n, 9, g), fetch(A + s, n, 9, a);
        fetch(F + s, n, 6, f), fetch(gains + s, n, 9, K);
        product(h, K, L);
        for (int i = 0; i < 9; i++) T[i] = all(i % 4 == 0);
        T[3] = -L[3], T[7] = -L[7], T[6] = L[7] * L[3] - L[6];
        product(K, T, KT);
        product(h, KT, by), product_2(f, by, corrected);
        for (int i = 0; i < 6; i++) felt[i] = corrected[i] - f[i], corrected[i] = -corrected[i];
        product_2(felt, h, felt_h), product_2(felt, g, felt_g);
        for (int i = 0; i < 2; i++) {
            vec factor = load(weight + i * n + s);
            row(step, i, factor, felt_h + 3 * i, felt_g + 3 * i, corrected + 3 * i);
            for (int l = 0; l < W; l++) step[88 * l + 11 * i + 6 + i] = factor[l];
        }
        product(T, h, by), product(T, g, by_g);
        for (int i = 0; i < 9; i++) by[i] = -by[i], by_g[i] = -by_g[i];
        for (int i = 0; i < 3; i++)
            row(step, ROW[i], load(weight + ROW[i] * n + s), by + 3 * i, by_g + 3 * i, T + 3 * i);
        product(a, KT, K), product(K, h, by), product(K, g, by_g);
        for (int i = 0; i < 9; i++) by[i] = a[i] - by[i], by_g[i] = h[i] - by_g[i];
        for (int i = 0; i < 3; i++) row(step, 5 + i, all(1.0), by + 3 * i, by_g + 3 * i, K + 3 * i);
    }
    return 1;
}

/* c = a b, 3 by 3 times 3. */
static inline void apply(const vec *a, const vec *b, vec *c)
{
    for (int i = 0; i < 3; i++) c[i] = a[3 * i] * b[0] + a[3 * i + 1] * b[1] + a[3 * i + 2] * b[2];
}

/* The innovations (5, windows, blocks) of `inputs` (blocks, windows, 11) that `maps` and `run` give, without maps. */
int residuals(size blocks, size windows, const double *H, const double *G, const double *A, const double *F,
              const double *gains, const double *weight, const double *inputs, double *out)
{
    static const int ROW[3] = {3, 4, 2};
    size n = blocks * windows;
    EACH_VECTOR(w, windows) {
        vec error[3];
        for (size b = 0; b < blocks; b++) {
            size s = b * windows + w;
            vec in[11], h[9], m[9], f[6], K[9], mean[3], change[3], shift[3] = {{0}}, value[5];
            for (int k = 0; k < 11; k++)
                for (int l = 0; l < W; l++) in[k][l] = inputs[11 * (s + l) + k];
            if (b == 0) memcpy(error, in, sizeof error);
            fetch(H + s, n, 9, h), fetch(G + s, n, 9, m), fetch(F + s, n, 6, f), fetch(gains + s, n, 9, K);
            apply(h, error, mean), apply(m, in + 3, change);
            for (int i = 0; i < 3; i++) {
                vec moved = h[3 * i] * shift[0] + h[3 * i + 1] * shift[1] + h[3 * i + 2] * shift[2];
                vec innovation = in[8 + i] - mean[i] - change[i] - moved;
                for (int k = 0; k < 3; k++) shift[k] += K[3 * k + i] * innovation;
                value[ROW[i]] = innovation;
            }
            for (int k = 0; k < 3; k++) error[k] += shift[k];
            apply(h, error, mean);
            for (int i = 0; i < 2; i++) {
                value[i] = in[6 + i];
                for (int k = 0; k < 3; k++) value[i] -= f[3 * i + k] * (mean[k] + change[k]);
            }
            fetch(A + s, n, 9, m);
            apply(m, error, mean), apply(h, in + 3, change);
            for (int k = 0; k < 3; k++) error[k] = mean[k] + change[k];
            for (int i = 0; i < 5; i++) {
                vec white = value[i] * load(weight + i * n + s);
                for (int l = 0; l < W; l++) out[(i * windows + w + l) * blocks + b] = white[l];
            }
        }
    }
    return 1;
}

/* Innovations (blocks, windows, 5) of `inputs` (blocks, windows, 11), whose state errors are overwritten. */
int run(size blocks, size windows, const double *maps, double *inputs, double *out)
{
    for (size b = 0; b < blocks; b++)
        for (size w = 0; w < windows; w++) {
            size s = b * windows + w;
            const double *step = maps + 88 * s, *in = inputs + 11 * s;
            double result[8];
            for (int i = 0; i < 8; i++) {
                result[i] = 0.0;
                for (int k = 0; k < 11; k++) result[i] += step[11 * i + k] * in[k];
            }
            memcpy(out + 5 * s, result, 5 * sizeof *out);
            if (b + 1 < blocks) memcpy(inputs + 11 * (s + windows), result + 5, 3 * sizeof *inputs);
        }
    return 1;
}

/* Derivatives (count, 5, windows, blocks) as the first `count` of the columns (blocks, windows, 5, width). */
int arrange(size blocks, size windows, size count, size width, const double *by, double *columns)
{
    for (size w = 0; w < windows; w++)
        for (size first = 0; first < blocks; first += TILE) {
            size end = first + TILE < blocks ? first + TILE : blocks;
            for (size c = 0; c < 5; c++)
                for (size k = 0; k < count; k++)
                    for (size b = first; b < end; b++)
                        columns[((b * windows + w) * 5 + c) * width + k] = by[((5 * k + c) * windows + w) * blocks + b];
        }
    return 1;
}

/* `some` columns, at most W, of one block of one window from their state errors (3, width) to those after it. */
static inline void move_columns(const double *m, const double *columns, double *out, size count, size some,
                                double *error, size width)
{
    vec in[8] = {{0}}, result[8];
    fetch(error, width, 3, in);
    for (int k = 0; k < 5; k++) memcpy(&in[3 + k], columns + k * count, some * sizeof *columns);
    for (int i = 0; i < 8; i++) {
        result[i] = m[8 * i] * in[0];
        for (int k = 1; k < 8; k++) result[i] += m[8 * i + k] * in[k];
    }
    for (int k = 0; k < 5; k++) memcpy(out + k * count, &result[k], some * sizeof *out);
    put(error, width, 3, result + 5);
}

/* Innovations (blocks, windows, 5, count) of derivatives of the channels, W of them at a time; `from` are the columns
   of a map for the state error and the channels, and `factor` what they are multiplied with. */
int run_columns(size blocks, size windows, size count, const double *maps, const size *from, const double *factor,
                const double *columns, double *out)
{
    size width = (count + W - 1) / W * W, full = count / W * W;
    double *errors = calloc(windows * 3 * width, sizeof *errors);
    if (!errors) return 0;
    for (size b = 0; b < blocks; b++)
        for (size w = 0; w < windows; w++) {
            size s = b * windows + w, at = s * 5 * count;
            double m[64], *error = errors + w * 3 * width;
            for (int i = 0; i < 8; i++)
                for (int k = 0; k < 8; k++) m[8 * i + k] = maps[88 * s + 11 * i + from[k]] * factor[k];
            for (size c = 0; c < full; c += W) move_columns(m, columns + at + c, out + at + c, count, W, error + c, width);
            if (full < count)
                move_columns(m, columns + at + full, out + at + full, count, count - full, error + full, width);
        }
    free(errors);
    return 1;
}

/* Products (width, width) of `width` columns (blocks, width), by tiles of W by W on and above the diagonal. */
static void products(size blocks, size width, const double *x, double *out)
{
    for (size i = 0; i < width; i += W)
        for (size j = i; j < width; j += W) {
            vec sum[W] = {{0}};
            for (size b = 0; b < blocks; b++) {
                const double *own = x + b * width;
                vec other = load(own + j);
                for (int k = 0; k < W; k++) sum[k] += own[i + k] * other;
            }
            for (int k = 0; k < W; k++) store(out + (i + k) * width + j, sum[k]);
        }
}

/* Add one channel of one window to its gradient (p) and hessian (p, p). */
static void add_window(size width, size count, const double *out, const ptrdiff_t *place, size p, double *gradient,
                       double *hessian)
{
    for (size i = 0; i < count; i++) {
        double *to = hessian + p * place[i];
        for (size j = 0; j < i; j++) to[place[j]] += out[j * width + i];
        for (size j = i; j < count; j++) to[place[j]] += out[i * width + j];
        gradient[place[i]] += out[i * width + count];
    }
}

/* Gradient (5, laps, p) and hessian (5, laps, p, p), zero before, of the windows' columns (blocks, windows, 5, count) at
   `places` (windows, count) and the residual (5, windows, blocks), which is one more column. */
int accumulate(size blocks, size windows, size count, size laps, size p, const double *error, const double *columns,
               const ptrdiff_t *places, const ptrdiff_t *lap, double *gradient, double *hessian)
{
    size width = (count + W) / W * W;
    double *x = calloc(blocks * width + width * width, sizeof *x), *out = x + blocks * width;
    if (!x) return 0;
    for (size w = 0; w < windows; w++)
        for (size c = 0; c < 5; c++) {
            size to = c * laps + lap[w];
            for (size b = 0; b < blocks; b++) {
                memcpy(x + b * width, columns + ((b * windows + w) * 5 + c) * count, count * sizeof *x);
                x[b * width + count] = error[(c * windows + w) * blocks + b];
            }
            products(blocks, width, x, out);
            add_window(width, count, out, places + w * count, p, gradient + to * p, hessian + to * p * p);
        }
    free(x);
    return 1;
}

/* W stages side by side in one vector of doubles (GCC vector extensions), and elementary functions on them.

   W and lane widths are set by the generator; W = 1 is plain C for compilers without vector extensions. Sums and
   products may be contracted to fused ones, otherwise the arithmetic is IEEE 754: NaN goes in, NaN comes out.
   sin, cos: Cody-Waite reduction to [-pi/4, pi/4] and Taylor series; atan: reduction to [0, tan(pi/8)] and the
   Chebyshev interpolant of atan(sqrt x)/sqrt x there; errors at most 4 units in the last place of the larger of
   result and 0.1, for tanh of 1. Arguments of sin and cos beyond 1e6 rad give NaN. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#if W > 1
typedef double vec __attribute__((vector_size(8 * W), may_alias));
typedef int64_t mask __attribute__((vector_size(8 * W), may_alias));
static inline vec all(double x) { return x - (vec){0}; }
static inline vec pick(mask m, vec a, vec b) { return (vec)(((mask)a & m) | ((mask)b & ~m)); }
static inline vec keep(mask m, vec a) { return (vec)((mask)a & m); }
static inline mask bits(vec a) { return (mask)a; }
static inline vec of_bits(mask a) { return (vec)a; }
static inline mask yes(vec a) { return a != 0.0; }
#define EACH(f, x) vec r; for (int l = 0; l < W; l++) r[l] = f((x)[l]); return r
#define EACH2(f, x, y) vec r; for (int l = 0; l < W; l++) r[l] = f((x)[l], (y)[l]); return r
#else
typedef double vec;
typedef int64_t mask;
static inline vec all(double x) { return x; }
static inline vec pick(mask m, vec a, vec b) { return m ? a : b; }
static inline vec keep(mask m, vec a) { return m ? a : 0.0; }
static inline mask bits(vec a) { mask m; memcpy(&m, &a, 8); return m; }
static inline vec of_bits(mask m) { vec a; memcpy(&a, &m, 8); return a; }
static inline mask yes(vec a) { return -(mask)(a != 0.0); }
#define EACH(f, x) return f(x)
#define EACH2(f, x, y) return f(x, y)
#endif

#if W == 1
#define TRUE_IF(c) (-(mask)(c))
#else
#define TRUE_IF(c) (c)
#endif

static inline vec v_abs(vec a) { return of_bits(bits(a) & INT64_MAX); }
static inline vec v_sqrt(vec a)
{
#if W == 4 && defined(__AVX__)
    return __builtin_ia32_sqrtpd256(a);
#else
    EACH(sqrt, a);
#endif
}
static inline vec v_max(vec a, vec b) { return pick(TRUE_IF(a != a), a, pick(TRUE_IF(a > b), a, b)); }
static inline vec v_min(vec a, vec b) { return pick(TRUE_IF(a != a), a, pick(TRUE_IF(a < b), a, b)); }

#define ROUND 0x1.8p52 /* added to a double below 2^51: the low bits hold the nearest integer */

static inline vec quarter_turns(vec x, mask *quarters)
{
    vec shifted = x * 0.63661977236758134308 + ROUND, n = shifted - ROUND;
    *quarters = bits(shifted);
    vec r = (x - n * 1.57079632673412561417) - n * 6.07710050650619224932e-11;
    return pick(TRUE_IF(v_abs(x) > 1e6), all(NAN), r);
}
static inline vec sin_series(vec x, vec q)
{
    vec p = q * (1.0 / 355687428096000.0) - 1.0 / 1307674368000.0;
    p = p * q + 1.0 / 6227020800.0;
    p = p * q - 1.0 / 39916800.0;
    p = p * q + 1.0 / 362880.0;
    p = p * q - 1.0 / 5040.0;
    p = p * q + 1.0 / 120.0;
    p = p * q - 1.0 / 6.0;
    return x + x * q * p;
}
static inline vec cos_series(vec q)
{
    vec p = q * (1.0 / 20922789888000.0) - 1.0 / 87178291200.0;
    p = p * q + 1.0 / 479001600.0;
    p = p * q - 1.0 / 3628800.0;
    p = p * q + 1.0 / 40320.0;
    p = p * q - 1.0 / 720.0;
    p = p * q + 1.0 / 24.0;
    return 1.0 - 0.5 * q + q * q * p;
}
static inline vec turned(vec x, int ahead)
{
    mask n;
    vec r = quarter_turns(x, &n), q = r * r;
    n += ahead;
    vec value = pick(TRUE_IF((n & 1) != 0), cos_series(q), sin_series(r, q));
    return of_bits(bits(value) ^ ((n & 2) << 62));
}
static vec v_sin(vec x) { return turned(x, 0); }
static vec v_cos(vec x) { return turned(x, 1); }
static inline vec v_tan(vec x) { return v_sin(x) / v_cos(x); }
static vec v_atan(vec x)
{
    vec a = v_abs(x);
    mask large = TRUE_IF(a > 2.41421356237309504880), middle = TRUE_IF(a > 0.41421356237309504880);
    vec above = pick(large, all(-1.0), pick(middle, a - 1.0, a));
    vec below = pick(large, a, pick(middle, a + 1.0, all(1.0)));
    vec y = above / below, q = y * y, p = q * -0.017805395704537506 + 0.037965256099576565;
    p = p * q - 0.050351024039430294;
    p = p * q + 0.05846878285787001;
    p = p * q - 0.06662951812061838;
    p = p * q + 0.07692045330765912;
    p = p * q - 0.09090896809056438;
    p = p * q + 0.11111110744919396;
    p = p * q - 0.1428571427925024;
    p = p * q + 0.1999999999994089;
    p = p * q - 0.3333333333333312;
    p = p * q + 1.0;
    vec offset = pick(large, all(1.57079632679489661923), keep(middle, all(0.78539816339744830962)));
    return of_bits(bits(offset + y * p) | (bits(x) & INT64_MIN));
}
static vec v_exp(vec x)
{
    x = pick(TRUE_IF(x > 700.0), all(700.0), pick(TRUE_IF(x < -700.0), all(-700.0), x));
    vec shifted = x * 1.44269504088896340736 + ROUND, n = shifted - ROUND;
    vec r = (x - n * 6.93147180369123816490e-01) - n * 1.90821492927058770002e-10;
    vec p = r * (1.0 / 6227020800.0) + 1.0 / 479001600.0;
    p = p * r + 1.0 / 39916800.0;
    p = p * r + 1.0 / 3628800.0;
    p = p * r + 1.0 / 362880.0;
    p = p * r + 1.0 / 40320.0;
    p = p * r + 1.0 / 5040.0;
    p = p * r + 1.0 / 720.0;
    p = p * r + 1.0 / 120.0;
    p = p * r + 1.0 / 24.0;
    p = p * r + 1.0 / 6.0;
    p = p * r + 0.5;
    p = p * r + 1.0;
    p = p * r + 1.0;
    return of_bits(bits(p) + (bits(shifted) << 52));
}
static vec v_tanh(vec x)
{
    vec a = v_abs(x);
    a = pick(TRUE_IF(a > 20.0), all(20.0), a);
    vec value = 1.0 - 2.0 / (v_exp(2.0 * a) + 1.0);
    return of_bits(bits(value) | (bits(x) & INT64_MIN));
}
static inline vec v_sign(vec x) { return pick(TRUE_IF(x > 0.0), all(1.0), pick(TRUE_IF(x < 0.0), all(-1.0), x)); }
static inline double sign(double x) { return x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : x; }
static inline vec v_floor(vec x) { EACH(floor, x); }
static inline vec v_ceil(vec x) { EACH(ceil, x); }
static inline vec v_log(vec x) { EACH(log, x); }
static inline vec v_asin(vec x) { EACH(asin, x); }
static inline vec v_acos(vec x) { EACH(acos, x); }
static inline vec v_sinh(vec x) { EACH(sinh, x); }
static inline vec v_cosh(vec x) { EACH(cosh, x); }
static inline vec v_atan2(vec y, vec x) { EACH2(atan2, y, x); }
static inline vec v_pow(vec x, vec y) { EACH2(pow, x, y); }
static inline vec v_fmod(vec x, vec y) { EACH2(fmod, x, y); }

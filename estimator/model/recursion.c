/* First-order lags of `memory`: y[i+1] = e y[i] + (1 - e) u[i] + (1 - (1 - e) / r) (u[i+1] - u[i]), e = exp(-r).

   The same steps as the numpy code there, which is used where there is no compiler. Every function returns 1. */

#include <complex.h>
#include <math.h>
#include <stddef.h>

typedef ptrdiff_t size;

/* `rows` signals of `count` values with a time constant for each value: r = dt / constant. */
int relaxed(size rows, size count, const double *t, const double *constant, const double *u, double *y)
{
    for (size k = 0; k < rows; k++) y[k * count] = u[k * count];
    for (size i = 0; i + 1 < count; i++) {
        double ratio = (t[i + 1] - t[i]) / fmax(constant[i + 1], 1e-9);
        double decay = exp(-ratio), gain = ratio > 1e-6 ? 1.0 - (1.0 - decay) / ratio : 0.5 * ratio;
        for (size k = 0; k < rows; k++) {
            const double *in = u + k * count + i;
            y[k * count + i + 1] = decay * y[k * count + i] + (1.0 - decay) * in[0] + gain * (in[1] - in[0]);
        }
    }
    return 1;
}

/* One signal of `count` values with a complex `pole`, 1/s: r = -pole dt. */
int mode(size count, const double *t, const double complex *pole, const double *u, double complex *y)
{
    y[0] = u[0];
    for (size i = 0; i + 1 < count; i++) {
        double complex ratio = -*pole * (t[i + 1] - t[i]), decay = cexp(-ratio);
        y[i + 1] = decay * y[i] + (1.0 - decay) * u[i] + (1.0 - (1.0 - decay) / ratio) * (u[i + 1] - u[i]);
    }
    return 1;
}

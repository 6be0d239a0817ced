/* y[0] = first, y[i+1] = decay[i] y[i] + drive[i] for `rows` signals of `count` values side by side. Returns 1. */

#include <stddef.h>

int recursion(ptrdiff_t rows, ptrdiff_t count, const double *first, const double *decay, const double *drive, double *y)
{
    for (ptrdiff_t k = 0; k < rows; k++) y[k * count] = first[k];
    for (ptrdiff_t i = 0; i + 1 < count; i++)
        for (ptrdiff_t k = 0; k < rows; k++)
            y[k * count + i + 1] = decay[i] * y[k * count + i] + drive[k * (count - 1) + i];
    return 1;
}

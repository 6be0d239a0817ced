/* The instruction list of a CasADi function, run on SIZE samples at a time: `estimator.model.columns.Columns` in C.

   The numbers of the operations, OP_..., are CasADi's and defined by `compiled_columns`. An instruction is its number,
   two registers or places that it reads, and one that it writes. Returns 1, or 0 where it found no working memory. */

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#define SIZE 256 /* samples: a few hundred registers of so many stay in the second-level cache */
typedef ptrdiff_t size;

/* A register may be read and written by one instruction, sample by sample: nothing depends on another sample. */
#define EACH(expression) \
    _Pragma("GCC ivdep") for (size i = 0; i < n; i++) { double x = a[i], y = b[i]; r[i] = (expression); (void)x, (void)y; } \
    break

static void operate(int operation, size n, const double *a, const double *b, double *r)
{
    switch (operation) {
    case OP_ASSIGN: EACH(x);
    case OP_ADD: EACH(x + y);
    case OP_SUB: EACH(x - y);
    case OP_MUL: EACH(x * y);
    case OP_DIV: EACH(x / y);
    case OP_NEG: EACH(-x);
    case OP_SQ: EACH(x * x);
    case OP_TWICE: EACH(x + x);
    case OP_INV: EACH(1.0 / x);
    case OP_SQRT: EACH(sqrt(x));
    case OP_FABS: EACH(fabs(x));
    case OP_SIGN: EACH(x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : x);
    case OP_FMIN: EACH(fmin(x, y));
    case OP_FMAX: EACH(fmax(x, y));
    case OP_FMOD: EACH(fmod(x, y));
    case OP_FLOOR: EACH(floor(x));
    case OP_CEIL: EACH(ceil(x));
    case OP_COPYSIGN: EACH(copysign(x, y));
    case OP_IF_ELSE_ZERO: EACH(x != 0.0 ? y : 0.0);
    case OP_LT: EACH(x < y);
    case OP_LE: EACH(x <= y);
    case OP_EQ: EACH(x == y);
    case OP_NE: EACH(x != y);
    case OP_AND: EACH(x != 0.0 && y != 0.0);
    case OP_OR: EACH(x != 0.0 || y != 0.0);
    case OP_NOT: EACH(x == 0.0);
    case OP_POW:
    case OP_CONSTPOW: EACH(pow(x, y));
    case OP_HYPOT: EACH(hypot(x, y));
    case OP_EXP: EACH(exp(x));
    case OP_EXPM1: EACH(expm1(x));
    case OP_LOG: EACH(log(x));
    case OP_LOG1P: EACH(log1p(x));
    case OP_SIN: EACH(sin(x));
    case OP_COS: EACH(cos(x));
    case OP_TAN: EACH(tan(x));
    case OP_ASIN: EACH(asin(x));
    case OP_ACOS: EACH(acos(x));
    case OP_ATAN: EACH(atan(x));
    case OP_ATAN2: EACH(atan2(x, y));
    case OP_SINH: EACH(sinh(x));
    case OP_COSH: EACH(cosh(x));
    case OP_TANH: EACH(tanh(x));
    }
}

static void fill(double *r, size n, double value)
{
    for (size i = 0; i < n; i++) r[i] = value;
}

/* Outputs (rows, count) of `steps` instructions (steps, 4) over `count` samples. `inputs` are the rows read, one value
   a sample where `per_sample` is set; `constants` (steps) what OP_CONST writes. */
int evaluate(size count, size steps, size registers, const size *program, const double *constants,
             const double *const *inputs, const size *per_sample, double *outputs)
{
    double *work = malloc(registers * SIZE * sizeof *work);
    if (!work) return 0;
    for (size first = 0; first < count; first += SIZE) {
        size n = count - first < SIZE ? count - first : SIZE;
        for (size s = 0; s < steps; s++) {
            const size *step = program + 4 * s;
            double *r = work + SIZE * step[3];
            if (step[0] == OP_INPUT && per_sample[step[1]]) memcpy(r, inputs[step[1]] + first, n * sizeof *r);
            else if (step[0] == OP_INPUT) fill(r, n, *inputs[step[1]]);
            else if (step[0] == OP_CONST) fill(r, n, constants[s]);
            else if (step[0] == OP_OUTPUT)
                memcpy(outputs + step[3] * count + first, work + SIZE * step[1], n * sizeof *r);
            else operate((int)step[0], n, work + SIZE * step[1], work + SIZE * step[2], r);
        }
    }
    free(work);
    return 1;
}

/* A plan beside the race line, and every limit of it at once: `checked_motion` on stages side by side.

   AROUND, MOST_LIFT and the numbers of rows are set by the generator. */

enum { GROUPS = (STAGES + W - 1) / W };

/* value `i` of W columns of `size` from stage `k` on; lanes beyond the last stage repeat it */
static inline vec column(const double *from, int size, int k, int i)
{
    vec v = all(0.0);
    for (int l = 0; l < W; l++) ((double *)&v)[l] = from[(k + l < STAGES ? k + l : STAGES - 1) * size + i];
    return v;
}

/* the point of `n` (more than AROUND) on a closed line, x and y in `points`, nearest to (x, y) around `middle` */
static int nearest(const double *points, int n, double x, double y, double middle)
{
    const int first = (int)fmod(fabs(middle) < 1e9 ? rint(middle) : 0.0, n) - AROUND + 2 * n;
    int best = 0;
    double least = INFINITY;
    for (int m = 0; m <= 2 * AROUND; m++) {
        const int i = (first + m) % n;
        const double dx = x - points[i], dy = y - points[n + i], distance = dx * dx + dy * dy;
        if (distance < least) least = distance, best = i;
    }
    return best;
}

/* rows `COLUMNS` of every stage, as `checks.plan_of` writes them, from the states z (NX, STAGES), the information of
   stages 1.. and the points (13, n) of `checks.Roadside`; behind a first column that repeats stage 0 */
void lay_out(const double *z, const double *information, const double *points, int32_t n, double per_metre,
             double *columns)
{
    for (int k = 0; k < STAGES; k++, z += NX) {
        double *to = columns + (k + 1) * COLUMNS;
        const double *at = points + nearest(points, n, z[0], z[1], z[6] * per_metre);
#define ROAD(row) at[(row) * n]
        const double dx = z[0] - ROAD(0), dy = z[1] - ROAD(1), cosine = ROAD(2), sine = ROAD(3);
        const double along = cosine * dx + sine * dy, extra = ROAD(8) + z[3] * (z[3] * ROAD(9) - z[5] * ROAD(10));
        for (int i = 0; i < 6; i++) to[i] = z[i];
        to[6] = z[8];
        to[7] = z[7];
        to[8] = extra < -MOST_LIFT ? -MOST_LIFT : extra;
        to[9] = cosine * dy - sine * dx;
        to[10] = ROAD(4) + along * ROAD(6);
        to[11] = ROAD(5) + along * ROAD(7);
        to[12] = k ? information[k - 1] : 0.0;
        to[13] = ROAD(11);
        to[14] = ROAD(12);
#undef ROAD
    }
    memcpy(columns, columns + COLUMNS, COLUMNS * sizeof *columns);
}

/* rows `FOUND` of every stage; whether all that they are found from are numbers */
int32_t check(const double *columns, const double *theta, const double *phi, const double *ratio, const double *bounds,
           double *found)
{
    (void)theta, (void)phi, (void)ratio, (void)bounds;
SHARED
    for (int g = 0; g < GROUPS; g++) {
        const int k = g * W;
        vec before[COLUMNS], after[COLUMNS], d[FOUND];
        for (int i = 0; i < COLUMNS; i++) before[i] = column(columns, COLUMNS, k, i);
        for (int i = 0; i < COLUMNS; i++) after[i] = column(columns + COLUMNS, COLUMNS, k, i);
EACH_GROUP
        for (int l = 0; l < W && k + l < STAGES; l++)
            for (int i = 0; i < FOUND; i++) found[(k + l) * FOUND + i] = ((const double *)&d[i])[l];
    }
    for (int i = 0; i < (STAGES + 1) * COLUMNS; i++)
        if (!isfinite(columns[i])) return 0;
    return 1;
}

/* The plan of one path, computed as in `Planner._in_python`, by the same kernels in the same order. This file holds no
 * equations. A path that cannot be followed is left to Python, which raises the error. The first argument of a kernel
 * holds the number of samples, then the address and the strides of each array, except the stride of its last axis. */

#include <stdlib.h>
#include <string.h>

typedef void (*kernel)(const int64_t *, int, int);
#define AT(x) ((int64_t)(intptr_t)(x))

static const kernel families[] = {FAMILIES};
static const int refused = -1;

static int any(const double *x, long n)
{
    double sum = 0;
    for (long i = 0; i < n; i++) sum += x[i];
    return sum != 0;
}

/* Number of integration steps of at most `longest` in a step h of a path whose position is an integral. */
static long divisions(double h, double longest)
{
    const double m = ceil((1 - 1e-9) * h / longest);
    return m < 1 ? 1 : (long)fmin(m, 1e6);
}

/* Derivatives (8, n) of such a path; the position is 0 at the sample `origin`. `memory` holds 12 ((n - 1) m + 1). */
static void integrated(double *d, const double *t, long n, long origin, long m, const double *p, double *memory)
{
    const long N = (n - 1) * m + 1;
    double *grid = memory, *course = grid + N, *way = course + 3 * N, *rates = m > 1 ? way + 2 * N : d + 2 * n;
    for (long i = 0; i < n - 1; i++)
        for (long j = 0; j < m; j++) grid[i * m + j] = t[i] + (t[i + 1] - t[i]) * j / m;
    grid[N - 1] = t[n - 1];
    memset(course, 0, 3 * N * sizeof(double));
    const int64_t turn[] = {N, AT(course), N, AT(grid), N, AT(p + 4), 3};
    add_sine(turn, 0, 3);
    const int64_t move[] = {N, AT(course), N, AT(grid), N, AT(p), AT(rates), N};
    velocity(move, 0, 1);
    const int64_t go[] = {N - 1, AT(grid), N, AT(grid + 1), N, AT(rates), N, AT(rates + 1), N, AT(way), N};
    displacement(go, 0, 1);
    for (int axis = 0; axis < 2; axis++) {
        double total = 0, *position = course + axis * N; /* reuses the memory of the course */
        for (long i = 0; i < N; i++) {
            position[i] = total;
            if (i < N - 1) total += way[axis * N + i];
        }
        for (long i = 0; i < n; i++) d[axis * n + i] = position[i * m] - position[origin * m];
    }
    for (long r = 0; m > 1 && r < 6; r++)
        for (long i = 0; i < n; i++) d[(2 + r) * n + i] = rates[r * N + i * m];
}

/* The sine of the sideslip at n samples, for the `terms` of its equation (4, n), see sideslip.py. */
static void sideslip(double *w, const double *along, const double *terms, long n, const double *c, const double *weights)
{
    double inputs[16], start[4], past[4];
    const int64_t first[] = {1, AT(along), n, AT(c), AT(start), 1};
    steady(first, 0, 1);
    for (int j = 0; j < 4; j++) {
        start[j] = start[0];
        for (int r = 0; r < 4; r++) inputs[4 * j + r] = terms[r * n + j];
    }
    const int64_t open[] = {1, AT(start), 1, AT(inputs), 1, AT(weights), 1, AT(past), 1};
    first_samples(open, 0, FIXED_POINT);
    memcpy(w, start, sizeof start);
    double history[] = {w[3], past[2], past[1], past[0]};
    const int64_t step[] = {1, AT(history), 1, AT(weights + 15), 1, AT(terms), 1, n, AT(w + 1), 1, 1};
    recursion(step, 3, (int)(n - 4));
}

/* Write a reference and return 0. Otherwise return the factor by which it must be sampled more finely, or `refused`.
 *
 * family: index in `families`; their number for `RandomSmooth`; -1 if the derivatives are given
 * pose: pose of the path, then its numbers, see `Family`
 * given: derivatives (8, n), or NULL
 * c: coefficients of the vehicle, then first and last time, step h, samples before the first time, instants T, samples
 *    from one instant to the next, h/MAX_RESPONSE (0 for a refined plan), h/Dm, the `LIMITS`, and the weights of the
 *    integration formulas of the sideslip
 * table: x, y, psi, u, v, r, F_u, F_r (T, 8)
 * rest: gamma, v_p, omega (3, T), or NULL
 */
int plan(int family, const double *pose, const double *given, const double *c, double *table, double *rest)
{
    const double *p = pose + 3, *s = c + VEHICLE, h = s[2];
    const long lead = (long)s[3], T = (long)s[4], substeps = (long)s[5], n = lead + (T - 1) * substeps + 1;
    const long m = family == FAMILY_COUNT ? divisions(h, p[13]) : 0;
    if (m > 1000) return refused; /* left to Python, which raises an error if the memory is too small */
    double *memory = malloc((25 * n + 12 * ((n - 1) * m + 1)) * sizeof(double));
    if (!memory) return refused;
    double *t = memory, *d = t + n, *position = d + 8 * n, *along = position + 2 * n, *terms = along + 6 * n;
    double *w = terms + 4 * n, *full_turns = w + n, *response = full_turns + n, *bad = response + n;
    int result = refused;

    for (long i = 0; i < n; i++) t[i] = s[0] + h * (i - lead);
    t[n - 1] = s[1]; /* exactly, since rounding could exceed the end of the path */
    const int64_t curve[] = {n, AT(t), n, AT(p), AT(d), n};
    if (family == FAMILY_COUNT) integrated(d, t, n, lead, m, p, bad + n);
    else if (family >= 0) families[family](curve, 0, 1);

    const int64_t look[] = {n, AT(family < 0 ? given : d), n, AT(pose), AT(s + 7), AT(c),
                            AT(position), n, AT(along), n, AT(terms), n, AT(response), n, AT(bad), n};
    along_path(look, 0, 1);
    if (any(bad, n)) goto done;
    double most = 0;
    for (long i = 0; i < n; i++) most = response[i] > most ? response[i] : most;
    if (most * s[6] > 1) {
        result = (int)fmin(ceil(most * s[6]), 1e6);
        goto done;
    }
    double *beta = along + n;
    const int64_t bend[] = {n - 1, AT(beta), n, AT(beta + 1), n, AT(full_turns + 1), n, AT(bad), n};
    turns(bend, 0, 1);
    if (any(bad, n - 1)) goto done;

    sideslip(w, along, terms, n, c, s + 8 + LIMITS);
    const int64_t slip[] = {n - lead, AT(w + lead), n, AT(bad), n};
    check_sideslip(slip, 0, 1);
    if (any(bad, n - lead)) goto done;

    double *moved = d; /* reuses the memory of the derivatives, and `rest` that of the terms */
    if (!rest) rest = terms;
    double total = 0;
    for (long i = lead + 1; i < n; i++) { /* make the direction continuous */
        total += full_turns[i];
        beta[i] -= 6.283185307179586 * total;
    }
    for (long r = 0; r < 8; r++) { /* keep the instants only; `along` follows `position` in memory */
        double *row = position + r * n;
        for (long i = 0; i < T; i++) row[i] = row[lead + i * substeps];
    }
    for (long i = 0; i < T; i++) w[i] = w[lead + i * substeps];
    memcpy(rest + T, along, T * sizeof(double));
    memcpy(rest + 2 * T, along + 2 * n, T * sizeof(double));
    const int64_t go[] = {T, AT(along), n, AT(w), n, AT(c), AT(s + 8), AT(moved), n, AT(rest), T, AT(bad), n};
    motion(go, 0, 1);
    if (any(bad, T)) goto done;
    for (long r = 0; r < 8; r++) {
        const double *row = r < 2 ? position + r * n : moved + (r - 2) * n;
        for (long i = 0; i < T; i++) table[8 * i + r] = row[i];
    }
    result = 0;
done:
    free(memory);
    return result;
}

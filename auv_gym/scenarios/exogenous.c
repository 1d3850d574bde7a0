/* The samples of episodes that run side by side, as `Tape._in_python` makes them: the same kernels in the same order, and
 * no equation of its own. Kernels take the number of control instants, then of each array the address and the strides of
 * all axes but the last. */

#include <string.h>

#define AT(x) ((int64_t)(intptr_t)(x))

typedef void (*fill)(void *generator, intptr_t count, double *normals);

/* Read the next `steps` samples of `count` lanes and wind on.
 *
 * most: components of the waves of which `waves` has room
 * time, row: strides of `out`
 * lanes, columns: which of them, and where in `out` each of them stands
 * entries, gusts, weathers, waves: `Entry` and numbers of every lane
 * memory: (TILE * (SAMPLES + NORMALS) + NORMALS + 3) * steps numbers
 * normal: what fills an array with standard normals
 */
void read_ahead(long count, long steps, long most, long time, long row, const int64_t *lanes, const int64_t *columns,
                int64_t *entries, double *gusts, const double *weathers, const double *waves, double *memory,
                double *out, fill normal)
{
    double *normals = memory + TILE * SAMPLES * steps, *turned = normals + TILE * NORMALS * steps;
    double *instants = turned + NORMALS * steps, *swing = instants + steps;
    for (long first = 0; first < count; first += TILE) {
        const long tile = count - first < TILE ? count - first : TILE;
        for (long l = 0; l < tile; l++) { /* all of them at once: what draws them needs the cache */
            const int64_t *entry = entries + lanes[first + l] * ENTRIES;
            const long count = (entry[END] - entry[FIRST]) * steps;
            if (count > 0) normal((void *)entry[GENERATOR], count, normals + l * NORMALS * steps);
        }
        for (long l = 0; l < tile; l++) {
            const long lane = lanes[first + l];
            int64_t *entry = entries + lane * ENTRIES;
            const long next = entry[NEXT], begin = entry[FIRST], width = entry[END] - begin;
            double *sample = memory + l * SAMPLES * steps, *gust = gusts + lane * GUST;
            const double *weather = weathers + lane * WEATHER, *wave = waves + lane * most * WAVE;

            if (width < NORMALS) memset(turned, 0, NORMALS * steps * sizeof(double));
            for (long r = 0; r < width; r++) {
                const double *from = normals + l * NORMALS * steps + r;
                double *to = turned + (begin + r) * steps;
                for (long j = 0; j < steps; j++, from += width) to[j] = *from;
            }
            for (long j = 0; j < steps; j++) instants[j] = next + j;
            entry[NEXT] = next + steps;

            const int64_t blow[] = {1, AT(gust), 1, AT(turned + GUSTS * steps), 1, steps, AT(weather), AT(swing), 1, steps};
            gust_recursion(blow, 0, (int)steps);
            double *current = sample + 8 * steps, *load = current + 2 * steps, *measured = load + 3 * steps;
            memset(load, 0, 3 * steps * sizeof(double));
            const int64_t roll[] = {steps, AT(load), steps, AT(instants), steps, AT(wave), WAVE};
            wave_loads(roll, 0, (int)entry[WAVES]);
            const int64_t see[] = {steps, AT(instants), steps, AT(swing), steps, AT(turned), steps, AT(weather),
                                   AT(current), steps, AT(measured), steps};
            current_and_noise(see, 0, 1);
            for (long j = 0; j < steps; j++) measured[6 * steps + j] = 1; /* there is a position fix */
        }
        for (long j = 0; j < steps; j++) /* the reference; behind its last instant that stays */
            for (long l = 0; l < tile; l++) {
                const int64_t *entry = entries + lanes[first + l] * ENTRIES;
                const long k = entry[NEXT] - steps + j, last = entry[INSTANTS] - 1;
                const double *from = (const double *)entry[TABLE] + 8 * (k < last ? k : last);
                double *to = out + j * time + columns[first + l];
                for (long r = 0; r < 8; r++, to += row) *to = from[r];
            }
        for (long r = 8; r < SAMPLES; r++)
            for (long j = 0; j < steps; j++) {
                const double *from = memory + r * steps + j;
                double *to = out + j * time + r * row;
                for (long l = 0; l < tile; l++, from += SAMPLES * steps) to[columns[first + l]] = *from;
            }
    }
}

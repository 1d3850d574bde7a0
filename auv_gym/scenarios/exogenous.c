/* The samples of several episodes, computed as in `ExogenousInputs._in_python`, by the same kernels in the same order.
 * This file holds no equations. The first argument of a kernel holds the number of control instants, then the address
 * and the strides of each array, except the stride of its last axis. */

#include <string.h>

#define AT(x) ((int64_t)(intptr_t)(x))

/* The interface of NumPy's bit generators, numpy/random/bitgen.h. */
typedef struct {
    void *state;
    uint64_t (*next_uint64)(void *);
    uint32_t (*next_uint32)(void *);
    double (*next_double)(void *);
    uint64_t (*next_raw)(void *);
} bitgen;

typedef double (*normal)(bitgen *);

/* The generator SFC64 of C. Doty-Humphrey, as in NumPy. */
static inline uint64_t next(uint64_t *s)
{
    const uint64_t x = s[0] + s[1] + s[3]++;
    s[0] = s[1] ^ (s[1] >> 11);
    s[1] = s[2] + (s[2] << 3);
    s[2] = ((s[2] << 24) | (s[2] >> 40)) + x;
    return x;
}

static uint64_t next_uint64(void *state) { return next(state); }
static double next_double(void *state) { return (next(state) >> 11) * 0x1p-53; }

/* Set the states (4) of generators as `numpy.random.SFC64(seed)` does, by the seed hash of M. E. O'Neill. */
void seed_states(long count, const uint64_t *seeds, uint64_t *states)
{
    for (long i = 0; i < count; i++) {
        uint32_t pool[4] = {(uint32_t)seeds[i], (uint32_t)(seeds[i] >> 32), 0, 0}, hash = 0x43b0d7e5;
        for (int j = 0; j < 4; j++) {
            pool[j] ^= hash;
            pool[j] *= hash *= 0x931e8875;
            pool[j] ^= pool[j] >> 16;
        }
        for (int from = 0; from < 4; from++)
            for (int to = 0; to < 4; to++) {
                if (from == to) continue;
                uint32_t x = pool[from] ^ hash;
                x *= hash *= 0x931e8875;
                x ^= x >> 16;
                pool[to] = 0xca01f9dd * pool[to] - 0x4973f715 * x;
                pool[to] ^= pool[to] >> 16;
            }
        uint64_t *s = states + 4 * i;
        hash = 0x8b51f9dd;
        for (int j = 0; j < 6; j++) {
            uint32_t x = pool[j % 4] ^ hash;
            x *= hash *= 0x58f38ded;
            x ^= x >> 16;
            s[j / 2] = j % 2 ? s[j / 2] | (uint64_t)x << 32 : x;
        }
        s[3] = 1;
        for (int j = 0; j < 12; j++) next(s);
    }
}

/* Standard normals of NumPy: a ziggurat of 256 layers. 99 % of the numbers are computed here, with its tables. */
static double width[256];   /* of a layer, over 2^52 */
static uint64_t inside[256]; /* smaller numbers of 52 bits lie inside of the layer */

static void draw(uint64_t *state, long count, double *normals, normal numpy_normal)
{
    uint64_t s[] = {state[0], state[1], state[2], state[3]};
    for (long i = 0; i < count; i++) {
        const uint64_t a = s[0], b = s[1], c = s[2], d = s[3], bits = next(s);
        const uint64_t layer = bits & 255, part = bits >> 9 & 0xfffffffffffff;
        double x = (double)(int64_t)part * width[layer];
        if (part < inside[layer]) {
            uint64_t signless;
            memcpy(&signless, &x, sizeof x);
            signless |= (bits & 256) << 55; /* without a branch, which could not be predicted */
            memcpy(&normals[i], &signless, sizeof x);
        } else {
            uint64_t before[4] = {a, b, c, d};
            bitgen generator = {before, next_uint64, NULL, next_double, next_uint64};
            normals[i] = numpy_normal(&generator);
            for (int j = 0; j < 4; j++) s[j] = before[j];
        }
    }
    for (int j = 0; j < 4; j++) state[j] = s[j];
}

/* A generator that returns one given number, then numbers that end every loop of NumPy, and counts its calls. */
static uint64_t probe_integer(void *state)
{
    uint64_t *s = state;
    return s[1]++ ? 0 : s[0];
}

static double probe_double(void *state)
{
    return ++((uint64_t *)state)[1] % 2 ? 0.5 : 0;
}

/* Determine the tables by calls of NumPy's function, and return whether `draw` gives its numbers. If not, the tables are
 * cleared, so that `draw` calls NumPy for all numbers. */
int load_tables(normal numpy_normal)
{
    for (uint64_t layer = 0; layer < 256; layer++) {
        uint64_t low = 0, high = (uint64_t)1 << 52; /* the first number that is not inside is between them */
        while (low < high) {
            uint64_t part = (low + high) / 2, state[2] = {part << 9 | layer, 0};
            bitgen generator = {state, probe_integer, NULL, probe_double, probe_integer};
            numpy_normal(&generator);
            if (state[1] == 1) low = part + 1;
            else high = part;
        }
        uint64_t one[2] = {(uint64_t)1 << 9 | layer, 0};
        bitgen generator = {one, probe_integer, NULL, probe_double, probe_integer};
        width[layer] = numpy_normal(&generator);
        inside[layer] = low;
    }
    uint64_t seed = 1, own[4], same[4];
    seed_states(1, &seed, own);
    memcpy(same, own, sizeof own);
    for (int i = 0; i < 100000; i++) {
        double x;
        draw(own, 1, &x, numpy_normal);
        bitgen generator = {same, next_uint64, NULL, next_double, next_uint64};
        if (x != numpy_normal(&generator) || memcmp(own, same, sizeof own)) {
            memset(inside, 0, sizeof inside);
            return 0;
        }
    }
    return 1;
}

/* Compute the least speed of the references (T, REFERENCE) of sub-environments. */
void least_speeds(long count, const int64_t *indices, const int64_t *entries, double *speeds)
{
    for (long i = 0; i < count; i++) {
        const int64_t *entry = entries + indices[i] * ENTRIES;
        const double *velocity = (const double *)entry[TABLE] + VELOCITY;
        double least = INFINITY;
        for (long k = 0; k < entry[INSTANTS]; k++, velocity += REFERENCE) {
            double square = velocity[0] * velocity[0];
            for (long j = 1; j < VELOCITIES; j++) square += velocity[j] * velocity[j];
            least = square < least ? square : least;
        }
        speeds[i] = sqrt(least);
    }
}

/* Write the next `steps` samples of `count` sub-environments.
 *
 * most: number of wave components in the array `waves`
 * time, row: strides of `out`
 * indices, columns: index of each sub-environment, and its column in `out`
 * entries, states, gusts, weathers, waves: `Entry`, state of the generator and numbers of all sub-environments
 * memory: (TILE * (SAMPLES + NORMALS) + NORMALS + 1 + CURRENT) * steps numbers, in space one more for each step
 * numpy_normal: function of standard normals of NumPy
 */
void read_samples(long count, long steps, long most, long time, long row, const int64_t *indices,
                  const int64_t *columns, int64_t *entries, uint64_t *states, double *gusts, const double *weathers,
                  const double *waves, double *memory, double *out, normal numpy_normal)
{
    double *normals = memory + TILE * SAMPLES * steps, *transposed = normals + TILE * NORMALS * steps;
    double *instants = transposed + NORMALS * steps, *swing = instants + steps;
    for (long first = 0; first < count; first += TILE) {
        const long tile = count - first < TILE ? count - first : TILE;
        for (long l = 0; l < tile; l++) { /* a loop of its own, since the tables of `draw` fill the cache */
            const int64_t *entry = entries + indices[first + l] * ENTRIES;
            const long numbers = (entry[END] - entry[FIRST]) * steps;
            draw(states + 4 * indices[first + l], numbers, normals + l * NORMALS * steps, numpy_normal);
        }
        for (long l = 0; l < tile; l++) {
            const long index = indices[first + l];
            int64_t *entry = entries + index * ENTRIES;
            const long next = entry[NEXT], begin = entry[FIRST], width = entry[END] - begin;
            double *sample = memory + l * SAMPLES * steps, *gust = gusts + index * GUST;
            const double *weather = weathers + index * WEATHER, *wave = waves + index * most * WAVE;

            if (width < NORMALS) memset(transposed, 0, NORMALS * steps * sizeof(double));
            for (long r = 0; r < width; r++) {
                const double *from = normals + l * NORMALS * steps + r;
                double *to = transposed + (begin + r) * steps;
                for (long j = 0; j < steps; j++, from += width) to[j] = *from;
            }
            for (long j = 0; j < steps; j++) instants[j] = next + j;
            entry[NEXT] = next + steps;

            const int64_t of_gusts[] = {1, AT(gust), 1, AT(transposed + GUSTS * steps), 1, steps, AT(weather),
                                        AT(swing), 1, steps};
            gust_recursion(of_gusts, 0, (int)steps);
            double *current = sample + REFERENCE * steps, *load = current + CURRENT * steps;
            double *measured = load + LOAD * steps;
            memset(load, 0, LOAD * steps * sizeof(double));
#ifdef HEIGHT
            double *depths = swing + CURRENT * steps;
            for (long j = 0; j < steps; j++) {
                const long k = next + j, last = entry[INSTANTS] - 1;
                depths[j] = -((const double *)entry[TABLE])[REFERENCE * (k < last ? k : last) + HEIGHT];
            }
            const int64_t of_waves[] = {steps, AT(load), steps, AT(instants), steps, AT(depths), steps, AT(wave), WAVE};
#else
            const int64_t of_waves[] = {steps, AT(load), steps, AT(instants), steps, AT(wave), WAVE};
#endif
            wave_loads(of_waves, 0, (int)entry[WAVES]);
            const int64_t of_rest[] = {steps, AT(instants), steps, AT(swing), steps, AT(transposed), steps, AT(weather),
                                       AT(current), steps, AT(measured), steps};
            current_and_noise(of_rest, 0, 1);
        }
        for (long j = 0; j < steps; j++) /* the reference; its last instant is repeated */
            for (long l = 0; l < tile; l++) {
                const int64_t *entry = entries + indices[first + l] * ENTRIES;
                const long k = entry[NEXT] - steps + j, last = entry[INSTANTS] - 1;
                const double *from = (const double *)entry[TABLE] + REFERENCE * (k < last ? k : last);
                double *to = out + j * time + columns[first + l];
                for (long r = 0; r < REFERENCE; r++, to += row) *to = from[r];
            }
        for (long r = REFERENCE; r < SAMPLES; r++)
            for (long j = 0; j < steps; j++) {
                const double *from = memory + r * steps + j;
                double *to = out + j * time + r * row;
                for (long l = 0; l < tile; l++, from += SAMPLES * steps) to[columns[first + l]] = *from;
            }
    }
}

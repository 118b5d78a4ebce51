/* Whole records, LANES of them in a vector. A tile of records goes through all times together, so
that what is handed out is written in long rows. */
#include <stdint.h>
#include <stdlib.h>

#if defined __AVX512F__
#define LANES 8
#elif defined __AVX__
#define LANES 4
#else
#define LANES 2
#endif
#ifndef TILE
#define TILE 64
#endif

typedef double vec __attribute__((vector_size(8 * LANES)));
typedef int64_t bits __attribute__((vector_size(8 * LANES)));

#define EACH for (int l = 0; l < LANES; l++)
#define SPREAD(part, kind, count) \
    for (int i = 0; i < (count); i++) ((vec *)&s->part)[i] = all((double)((const kind *)&one->part)[i])
#define COPY(part) memcpy(&s->part, &one->part, sizeof s->part)
#define ALL (~(bits){ 0 })

/* What is handed out is not read again soon: past the caches, where the processor can do that. */
#if defined __clang__
#define PAST_CACHES(place, a) __builtin_nontemporal_store(a, (vec *)(place))
#elif defined __AVX512F__
#define PAST_CACHES(place, a) __builtin_ia32_movntpd512((double *)(place), a)
#elif defined __AVX__
#define PAST_CACHES(place, a) __builtin_ia32_movntpd256((double *)(place), a)
#elif defined __SSE2__
#define PAST_CACHES(place, a) __builtin_ia32_movntpd((double *)(place), a)
#else
#define PAST_CACHES(place, a) (*(vec *)(place) = (a))
#endif

static inline vec all(double a) { return a - (vec){ 0 }; }
static inline bits all_or_none(int truth) { return (bits){ 0 } - (int64_t)(truth != 0); }
static inline vec choose(bits q, vec a, vec b) { return (vec)((q & (bits)a) | (~q & (bits)b)); }
static inline vec as_numbers(bits q) { return (vec)(q & (bits)all(1.0)); }
static inline int any(bits q)
{
#ifdef __AVX__
    typedef double quad __attribute__((vector_size(32)));
    quad parts[LANES / 4];
    int found = 0;
    memcpy(parts, &q, sizeof q);
    for (int k = 0; k < LANES / 4; k++) found |= __builtin_ia32_movmskpd256(parts[k]);
#else
    int64_t found = 0;
    EACH found |= q[l];
#endif
    return found != 0;
}

static inline bits v_isnan(vec a) { return a != a; }
static inline bits v_isfinite(vec a) { return a - a == 0.0; }
static inline vec v_fabs(vec a) { return (vec)((bits)a & INT64_MAX); }
static inline bits v_isinf(vec a) { return v_fabs(a) == all(HUGE_VAL); }
#define INLINE1(f) \
    static inline vec v_##f(vec a) { vec r; EACH r[l] = __builtin_##f(a[l]); return r; }
INLINE1(sqrt)
INLINE1(floor)
INLINE1(ceil)

/* Functions of libm, vectors where the C library has them (LIBMVEC). A call for each lane goes
through memory: registers that are half in use as vectors would stall it. */
#if defined LIBMVEC && LANES == 8
#define VECTOR_NAME(f, v) _ZGVeN8##v##_##f
#elif defined LIBMVEC && defined __AVX2__
#define VECTOR_NAME(f, v) _ZGVdN4##v##_##f
#elif defined LIBMVEC && LANES == 2
#define VECTOR_NAME(f, v) _ZGVbN2##v##_##f
#endif
#ifdef VECTOR_NAME
#define FUNCTION1(f) \
    vec VECTOR_NAME(f, v)(vec); \
    static inline vec v_##f(vec a) { return VECTOR_NAME(f, v)(a); }
#define FUNCTION2(f) \
    vec VECTOR_NAME(f, vv)(vec, vec); \
    static inline vec v_##f(vec a, vec b) { return VECTOR_NAME(f, vv)(a, b); }
#else
#define FUNCTION1(f) LANE_BY_LANE1(f)
#define FUNCTION2(f) LANE_BY_LANE2(f)
#endif
#ifdef __AVX__
#define LEAVE_VECTORS __builtin_ia32_vzeroupper()
#else
#define LEAVE_VECTORS (void)0
#endif
#define LANE_BY_LANE1(f) \
    static __attribute__((noinline, unused)) vec v_##f(vec a) \
    { \
        double x[LANES], r[LANES]; \
        memcpy(x, &a, sizeof x); \
        LEAVE_VECTORS; \
        EACH r[l] = f(x[l]); \
        memcpy(&a, r, sizeof a); \
        return a; \
    }
#define LANE_BY_LANE2(f) \
    static __attribute__((noinline, unused)) vec v_##f(vec a, vec b) \
    { \
        double x[LANES], y[LANES], r[LANES]; \
        memcpy(x, &a, sizeof x); \
        memcpy(y, &b, sizeof y); \
        LEAVE_VECTORS; \
        EACH r[l] = f(x[l], y[l]); \
        memcpy(&a, r, sizeof a); \
        return a; \
    }
/* FUNCTIONS */

/* STATE */

static inline int lanes_step(lanes *restrict s, double time, const vec *restrict y, vec indicator,
                             const vec *restrict held, const vec *restrict u, const vec *restrict p)
{
    (void)time, (void)indicator, (void)held, (void)u, (void)p;
/* STEP */
    return F_OK;
}

/* Numbers of LANES records from a row; beyond its end those of the last record. */
static inline vec load(const double *row, int64_t first, int64_t stop)
{
    vec a;
    if (first + LANES <= stop) memcpy(&a, row + first, sizeof a);
    else EACH a[l] = row[first + l < stop ? first + l : stop - 1];
    return a;
}

static inline void save(double *row, vec a, int64_t first, int64_t stop)
{
    if (first + LANES <= stop && (uintptr_t)(row + first) % sizeof a == 0) {
        PAST_CACHES(row + first, a);
    }
    else EACH if (first + l < stop) row[first + l] = a[l];
}

/* Rows of some numbers of the state: number j of record i stands at [j * wide + i]. */
#define ROWS(to, part, count) \
    for (int j = 0; to && j < (count); j++) \
        for (int g = 0; g < groups; g++) \
            save(to + (k * (int64_t)(count) + j) * wide, ((const vec *)&tile[g].part)[j], \
                 first + g * LANES, stop)

int api_run(int64_t start, int64_t stop, int64_t total, int64_t wide, int64_t times, const double *t,
            const double *y, const double *indicator, const double *u, const double *p, double bound,
            double *mean, double *cov, double *prob, double *loglik, char *diverged, double *mode);
int api_run(int64_t start, int64_t stop, int64_t total, int64_t wide, int64_t times, const double *t,
            const double *y, const double *indicator, const double *u, const double *p, double bound,
            double *mean, double *cov, double *prob, double *loglik, char *diverged, double *mode)
{
    lanes tile[TILE / LANES];
    vec p_[TILE / LANES][F_PARAMETERS + 1], y_[F_MEASUREMENT], held_[F_INPUTS + 1], u_[F_INPUTS + 1];
    f_state one;
    f_init(&one);
    (void)prob, (void)mode;
    for (int64_t first = start; first < stop; first += TILE) {
        const int count = stop - first < TILE ? (int)(stop - first) : TILE;
        const int groups = (count + LANES - 1) / LANES;
        bits lost[TILE / LANES];
        for (int g = 0; g < groups; g++) {
            begin(&tile[g], &one);
            lost[g] = (bits){ 0 };
            for (int j = 0; j < F_PARAMETERS; j++) {
                p_[g][j] = load(p + j * total, first + g * LANES, stop);
            }
        }
        for (int64_t k = 0; k < times; k++) {
            const int64_t before = k > 0 ? k - 1 : 0;
            for (int g = 0; g < groups; g++) {
                const int64_t i = first + g * LANES;
                for (int j = 0; j < F_MEASUREMENT; j++) {
                    y_[j] = load(y + (k * F_MEASUREMENT + j) * total, i, stop);
                }
                for (int j = 0; j < F_INPUTS; j++) {
                    held_[j] = load(u + (before * F_INPUTS + j) * total, i, stop);
                    u_[j] = load(u + (k * F_INPUTS + j) * total, i, stop);
                }
                const vec seen = indicator ? load(indicator + k * total, i, stop) : (vec){ 0 };
                const int code = lanes_step(&tile[g], t[k], y_, seen, held_, u_, p_[g]);
                if (code != F_OK) return code;
                for (int j = 0; j < F_OUT; j++) lost[g] |= ~(v_fabs(tile[g].mean[j]) <= bound);
            }
            ROWS(mean, mean, F_OUT);
            ROWS(cov, cov, F_OUT * F_OUT);
            ROWS(loglik, loglik, 1);
/* MODES */
        }
        for (int g = 0; diverged && g < groups; g++) {
            EACH if (g * LANES + l < count) diverged[first + g * LANES + l] = lost[g][l] != 0;
        }
    }
    return F_OK;
}

"""C of a switching filter with a memory: what it says of mode and state, and its step."""

DESIGNED_STEP = """\
/* One measurement: forecast from the memory, correction, memory. NaN: component missing. */
static inline int @name_step(@name_state *s, const double *y@TOLD)
{
    double ahead[@NAME_PARTS], later[@NAME_PARTS][@NAME_LAW];
    double score[@NAME_MODES], law[@NAME_MODES][@NAME_LAW];
    const int gap = isnan(s->cov[0][0]); /* the design knows no gaps */
    int i, lost = gap, parts = 1;@ENDS
    for (i = 0; i < @NAME_MEASUREMENT; i++) {
        if (isinf(y[i])) return @NAME_INFINITE;
@LOST
    }
@WATCH    if (s->k > 0) {
        @LENGTH@name_known_(s, score, law);
        @name_propagate_(@name_times[s->k - 1]@LATER, score, law, ahead, later@WITH);
        parts = @NAME_EACH;
    } else {
        memcpy(ahead, @name_score0, sizeof @name_score0);
        memcpy(later[0], @name_law0, sizeof @name_law0);
    }
    @name_take_(@name_times[s->k]@LATER, parts, ahead, later, @SEEN, y, s, score, law);
    if (gap) s->loglik = (double)NAN;
    for (i = 0; lost && i < @NAME_STATE * @NAME_STATE; i++) {
        s->cov[(int)(i / @NAME_STATE)][i % @NAME_STATE] = (double)NAN;
    }
    @name_push_(s, score, @SEEN);
    s->k++;@LAP
    return @NAME_OK;
}
"""

KNOWN = """\
typedef struct {
    int size; /* numbers that are remembered */
    const double *weight, *centre, *white, *gain, *offset, *cov; /* by cell and mode */
} @name_fit;
"""

FORECAST = """\
/* Law of mode and state given the memory. */
static inline void @name_known_(const @name_state *s, double *score,
                                double law[@NAME_MODES][@NAME_LAW])
{
    const @name_fit *fit = &@name_fits[s->k - 1];
    const int d = fit->size, low = @NAME_STATE * (@NAME_STATE + 1) / 2;
    const int estimates = s->k < @NAME_HELD_ESTIMATES ? s->k : @NAME_HELD_ESTIMATES;
    double z[@NAME_MEMORY] = { 0.0 }, apart[@NAME_MEMORY] = { 0.0 };
    int i, j, q, at, cell = 0;
    for (i = 0; i < estimates; i++) cell = cell * @NAME_MODES + s->modes[i];
    for (i = 0; i < s->k && i < @NAME_HELD_INDICATORS; i++) {
        cell = cell * @NAME_INDICATORS + s->told[i];
    }
    for (i = 0; i < d; i++) {
        j = i < estimates * @NAME_BLOCK
            ? i : i + (@NAME_HELD_ESTIMATES - estimates) * @NAME_BLOCK;
        z[i] = s->memory[j];
    }
    for (i = 0; i < @NAME_MODES; i++) {
        at = cell * @NAME_MODES + i;
        score[i] = fit->weight[at];
        for (j = 0; j < d; j++) apart[j] = z[j] - fit->centre[at * d + j];
        for (j = 0; j < d; j++) {
            double sum = 0.0;
            for (q = 0; q < d; q++) sum += fit->white[(at * d + j) * d + q] * apart[q];
            score[i] -= 0.5 * sum * sum;
        }
        for (j = 0; j < @NAME_STATE; j++) {
            double sum = fit->offset[at * @NAME_STATE + j];
            for (q = 0; q < d; q++) sum += fit->gain[(at * @NAME_STATE + j) * d + q] * z[q];
            law[i][j] = sum;
        }
        for (j = 0; j < low; j++) law[i][@NAME_STATE + j] = fit->cov[at * low + j];
    }
    @name_normalise_(@NAME_MODES, score);
}
"""

PUSH = """\
static inline void @name_push_(@name_state *s, const double *score, int shown)
{
    int i;
    for (i = @NAME_HELD_ESTIMATES * @NAME_BLOCK - 1; i >= @NAME_BLOCK; i--) {
        s->memory[i] = s->memory[i - @NAME_BLOCK];
    }
    for (i = @NAME_HELD_ESTIMATES - 1; i > 0; i--) s->modes[i] = s->modes[i - 1];
    for (i = @NAME_HELD_INDICATORS - 1; i > 0; i--) s->told[i] = s->told[i - 1];
    for (i = @NAME_MEMORY - 1; i >= @NAME_HELD_ESTIMATES * @NAME_BLOCK + @NAME_MEASUREMENT; i--) {
        s->memory[i] = s->memory[i - @NAME_MEASUREMENT];
    }
    if (@NAME_HELD_ESTIMATES) {
        memcpy(s->memory, s->mean, sizeof s->mean);
        s->modes[0] = s->mode;
    }
    for (i = @NAME_STATE; @NAME_HELD_ESTIMATES && i < @NAME_BLOCK; i++) { /* log-odds */
        const double odds = score[i - @NAME_STATE + 1] - score[0];
        s->memory[i] = isnan(odds) ? 0.0 : odds > @SOFT ? @SOFT : odds < -@SOFT ? -@SOFT : odds;
    }
    for (i = 0; @NAME_MEMORY > @NAME_HELD_ESTIMATES * @NAME_BLOCK && i < @NAME_MEASUREMENT; i++) {
        s->memory[@NAME_HELD_ESTIMATES * @NAME_BLOCK + i] = s->shown[i];
    }
    if (@NAME_HELD_INDICATORS) s->told[0] = shown;
    (void)score; (void)shown;
}
"""

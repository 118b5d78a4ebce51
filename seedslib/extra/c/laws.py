"""C of what a switching filter does with laws of modes and states: weights, mixtures, steps."""

MIX = """\
/* exp(score - largest), and the largest, zero where nothing has a finite weight. */
static inline double @name_relative_(int count, const double *score, double *weight)
{
    double highest = score[0];
    int i;
    for (i = 1; i < count; i++) if (score[i] > highest || isnan(score[i])) highest = score[i];
    if (!isfinite(highest)) highest = 0.0;
    for (i = 0; i < count; i++) weight[i] = exp(score[i] - highest);
    return highest;
}

/* Logarithms of weights whose sum is one; returns that of their sum before. */
static inline double @name_normalise_(int count, double *score)
{
    double weight[@MOST], sum = 0.0, highest = score[0];
    int i;
    for (i = 1; i < count; i++) if (score[i] > highest || isnan(score[i])) highest = score[i];
    if (!isfinite(highest)) return highest;
    for (i = 0; i < count; i++) weight[i] = exp(score[i] - highest);
    for (i = 0; i < count; i++) sum += weight[i];
    sum = log(sum);
    for (i = 0; i < count; i++) score[i] = (score[i] - highest) - sum;
    return highest + sum;
}

/* Mass, mean and covariance, on and below the diagonal, of several weighted laws together. */
static inline double @name_mix_(int count, int size, int stride, const double *mass,
                                const double *parts, double *mean, double *lower)
{
    double total = 0.0, apart[@NAME_JOINT];
    int i, j, k, p;
    for (i = 0; i < size; i++) mean[i] = 0.0;
    for (k = 0; k < size * (size + 1) / 2; k++) lower[k] = 0.0;
    for (p = 0; p < count; p++) if (!(mass[p] <= 0.0)) total += mass[p];
    if (total == 0.0) {
        for (i = 0; i < size; i++) lower[i * (i + 3) / 2] = 1.0;
        return 0.0;
    }
    for (p = 0; p < count; p++) {
        const double share = mass[p] / total;
        if (!(mass[p] <= 0.0)) {
            for (i = 0; i < size; i++) mean[i] += share * parts[p * stride + i];
        }
    }
    for (p = 0; p < count; p++) {
        const double share = mass[p] / total;
        if (mass[p] <= 0.0) continue;
        for (i = 0; i < size; i++) apart[i] = parts[p * stride + i] - mean[i];
        for (i = 0, k = 0; i < size; i++) {
            for (j = 0; j <= i; j++, k++) {
                lower[k] += share * (parts[p * stride + size + k] + apart[i] * apart[j]);
            }
        }
    }
    return total;
}
"""

STATE = """\
typedef struct {
@HEADER    double mean[@NAME_STATE]; /* estimate */
    double cov[@NAME_STATE][@NAME_STATE]; /* its covariance@GAPS */
    double prob[@NAME_MODES]; /* probabilities of the modes */
    int mode; /* decided mode */
    double loglik; /* log-density of the last measurement@AFTER */
@HELD} @name_state;

static inline void @name_init(@name_state *s)
{
    memset(s, 0, sizeof *s);
@BEGIN}
"""

PROPAGATE = """\
/* Forecast of mode and state from their law at time t. */
static inline void @name_propagate_(double t, const double *score,
                                    double law[@NAME_MODES][@NAME_LAW], double *ahead,
                                    double later[@NAME_PARTS][@NAME_LAW]@ALSO)
{
    double made[@NAME_MODES][@NAME_PARTS][1 + @NAME_LAW], heavy[@NAME_MODES], mass[@NAME_MODES];
    const double highest = @name_relative_(@NAME_MODES, score, heavy);
    const int stride = @NAME_PARTS * (1 + @NAME_LAW);
    int i, p;
    for (i = 0; i < @NAME_MODES; i++) @name_move_(i, t, law[i], made[i][0]@WITH);
    for (p = 0; p < @NAME_PARTS; p++) {
        double total;
        for (i = 0; i < @NAME_MODES; i++) mass[i] = heavy[i] * made[i][p][0];
        total = @name_mix_(@NAME_MODES, @NAME_STATE, stride, mass, made[0][p] + 1, later[p],
                           later[p] + @NAME_STATE);
        ahead[p] = highest + log(total);
        if (total < @NAME_FAINT) { /* so little that it is formed again by itself */
            double logs[@NAME_MODES], most;
            for (i = 0; i < @NAME_MODES; i++) logs[i] = score[i] + log(made[i][p][0]);
            most = @name_relative_(@NAME_MODES, logs, mass);
            total = @name_mix_(@NAME_MODES, @NAME_STATE, stride, mass, made[0][p] + 1, later[p],
                               later[p] + @NAME_STATE);
            ahead[p] = most + log(total);
        }
    }
}
"""

SWITCHED = """\
/* Law after the switch at time t and before the move, which the new mode drives. */
""" + PROPAGATE[PROPAGATE.index("static") :].replace("@name_propagate_", "@name_switched_").replace(
    "@name_move_", "@name_switch_"
).replace("@NAME_PARTS", "@NAME_MODES")

BOTH = """\
/* Forecast of mode and state: a switch, then a move of the new mode. */
static inline void @name_propagate_(double t, const double *score,
                                    double law[@NAME_MODES][@NAME_LAW], double *ahead,
                                    double later[@NAME_PARTS][@NAME_LAW]@ALSO)
{
    double turned[@NAME_MODES], stands[@NAME_MODES][@NAME_LAW];
    @name_switched_(t, score, law, turned, stands@WITH);
    @name_moved_(t, turned, stands, ahead, later@WITH);
}
"""

SENSE = """\
/* Law of mode, state and measurement given the indicator; whether any mode can have shown it. */
static inline int @name_sense_(double t, int parts, const double *ahead,
                               double later[@NAME_PARTS][@NAME_LAW], int shown, double *score,
                               double joint[@NAME_MODES][@NAME_BOTH])
{
    double out[@NAME_EACH][1 + @NAME_BOTH] = { { 0.0 } }, logs[@NAME_EACH], mass[@NAME_EACH];
    int i, p, k, possible = 0;
    for (i = 0; i < @NAME_MODES; i++) {
        for (p = 0; p < parts; p++) {
            @name_read_(i, shown, t, later[i * parts + p], out[p]);
            logs[p] = ahead[i * parts + p] + log(out[p][0]);
        }
        if (parts == 1 && logs[0] > -HUGE_VAL) {
            for (k = 0; k < @NAME_BOTH; k++) joint[i][k] = out[0][1 + k];
            score[i] = logs[0];
        } else {
            const double highest = @name_relative_(parts, logs, mass);
            score[i] = highest + log(@name_mix_(parts, @NAME_JOINT, 1 + @NAME_BOTH, mass,
                                                out[0] + 1, joint[i], joint[i] + @NAME_JOINT));
        }
        if (!(score[i] == -HUGE_VAL)) possible = 1;
    }
    return possible;
}
"""

TAKE = """\
/* The estimate by a measurement from a forecast. */
static inline void @name_take_(double t, int parts, const double *ahead,
                               double later[@NAME_PARTS][@NAME_LAW], int shown, const double *y,
                               @name_state *s, double *score, double law[@NAME_MODES][@NAME_LAW])
{
    double joint[@NAME_MODES][@NAME_BOTH], before[@NAME_MODES], each, loglik, most = 0.0;
    double lower[@NAME_STATE * (@NAME_STATE + 1) / 2];
    int i, j, k, possible = @name_sense_(t, parts, ahead, later, shown, score, joint);
    if (!possible && shown >= 0) @name_sense_(t, parts, ahead, later, -1, score, joint);
    for (i = 0; i < @NAME_MODES; i++) {
        before[i] = score[i];
        each = @name_correct_(joint[i], y, law[i]);
        score[i] = score[i] == -HUGE_VAL ? -HUGE_VAL : score[i] + each;
    }
@EXPECT    loglik = @name_normalise_(@NAME_MODES, score);
    if (!isfinite(loglik)) { /* no mode explains the measurement: keep what was forecast */
        memcpy(score, before, sizeof before);
        @name_normalise_(@NAME_MODES, score);
    }
    s->loglik = possible || shown < 0 ? loglik : -HUGE_VAL;
    for (i = 0; i < @NAME_MODES; i++) {
        s->prob[i] = exp(score[i]);
        if (i == 0 || s->prob[i] > most) most = s->prob[i];
    }
    for (s->mode = 0; s->mode < @NAME_MODES - 1; s->mode++) {
        if (s->prob[s->mode] >= @TIE * most) break;
    }
    for (k = 0; k < @NAME_STATE; k++) {
        s->mean[k] = 0.0;
        for (i = 0; i < @NAME_MODES; i++) s->mean[k] += s->prob[i] * law[i][k];
    }
    @name_mix_(@NAME_MODES, @NAME_STATE, @NAME_LAW, s->prob, law[0], joint[0], lower);
    for (i = 0; i < @NAME_STATE; i++) {
        for (j = 0; j <= i; j++) s->cov[i][j] = s->cov[j][i] = lower[i * (i + 1) / 2 + j];
    }
}
"""

EXPECT = """\
    @name_relative_(@NAME_MODES, before, s->prob);
    for (i = 0; i < @NAME_MODES; i++) most += s->prob[i];
    for (k = 0; k < @NAME_MEASUREMENT; k++) { /* a missing one is remembered as expected */
        s->shown[k] = 0.0;
        for (i = 0; i < @NAME_MODES; i++) {
            s->shown[k] += s->prob[i] / most * joint[i][@NAME_STATE + k];
        }
        if (!isnan(y[k])) s->shown[k] = y[k];
    }
"""

CARRIED_STEP = """\
/* One measurement: forecast to its time and correction. NaN: component missing. */
static inline int @name_step(@name_state *s, double t, const double *y@TOLD)
{
    double ahead[@NAME_PARTS], later[@NAME_PARTS][@NAME_LAW];
    int i, parts = 1;
    if (!isfinite(t) || (s->started && t <= s->t)) return @NAME_TIME;
    for (i = 0; i < @NAME_MEASUREMENT; i++) if (isinf(y[i])) return @NAME_INFINITE;
@WATCH    if (s->started) {
        @LENGTH@name_propagate_(s->t, s->score, s->law, ahead, later@WITH);
        parts = @NAME_EACH;
    } else {
        memcpy(ahead, @name_score0, sizeof @name_score0);
        memcpy(later[0], @name_law0, sizeof @name_law0);
    }
    @name_take_(t, parts, ahead, later, @SEEN, y, s, s->score, s->law);
    s->t = t;
    s->started = 1;
    return @NAME_OK;
}
"""

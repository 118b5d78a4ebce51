
/* Forecast to a time, without a measurement. */
static inline int @name_predict(@name_state *s, double time@INPUTS)
{
    @name_real y[@NAME_MEASUREMENT];
    const @name_real loglik = s->loglik;
    int i, code;
    for (i = 0; i < @NAME_MEASUREMENT; i++) y[i] = (@name_real)NAN;
    code = @name_step(s, time, y@PASSED);
    s->loglik = loglik;
    return code;
}

/* Correction by a measurement at the time of the state. */
static inline int @name_correct(@name_state *s, const @name_real *y@INPUTS)
{
    return s->started ? @name_step(s, s->t, y@PASSED) : @NAME_TIME;
}

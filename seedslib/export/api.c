/* What Python calls with bytes. CALL is a step with those arguments that the filter has. */

void api_init(f_state *s);
void api_init(f_state *s)
{
    f_init(s);
}

/* One measurement of each of some records. Rows of `count` numbers are given: time, measurement,
indicator, inputs since the last time and at this one, parameters. */
int api_steps(const f_state *s, f_state *out, const double *given, int count);
int api_steps(const f_state *s, f_state *out, const double *given, int count)
{
    double one[1 + F_MEASUREMENT + 1 + 2 * F_INPUTS + F_PARAMETERS];
    const double *y = one + 1, *held = y + F_MEASUREMENT + 1, *u = held + F_INPUTS, *p = u + F_INPUTS;
    const int size = sizeof one / sizeof *one;
    (void)held, (void)u, (void)p;
    for (int i = 0; i < count; i++) {
        int code;
        for (int j = 0; j < size; j++) one[j] = given[j * count + i];
        out[i] = s[i];
        code = CALL(&out[i], one[0], y, (int)one[1 + F_MEASUREMENT], held, u, p);
        if (code != F_OK) return code;
    }
    return F_OK;
}

/* One record of a filter that is given no more than a time and a measurement. */
int api_step(const f_state *s, f_state *out, const double *given);
int api_step(const f_state *s, f_state *out, const double *given)
{
    *out = *s;
    return CALL(out, given[0], given + 1, -1, NULL, NULL, NULL);
}

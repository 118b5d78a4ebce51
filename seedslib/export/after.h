
/* One measurement, dt after the one before; the first is at time 0. */
@SIGNATURE
{
    return @name_step(@PASSED);
}

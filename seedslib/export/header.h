#ifndef @NAME_H
#define @NAME_H

#include <math.h>
#include <string.h>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "@name: wanted a compiler that keeps NaN; leave -ffast-math and -ffinite-math-only out"
#endif

typedef double @name_real; /* what numbers are; times stay double */

#define @NAME_OK 0       /* what the functions return */
#define @NAME_END 1      /* no more measurement times in the design */
#define @NAME_INFINITE 2 /* a measurement that is infinite */
#define @NAME_PARTLY 3   /* a measurement of which only some components are there */
#define @NAME_TIME 4     /* a time that is not where it should be */
#define @NAME_RANGE 5    /* an indicator that is none */
#define @NAME_STRAY 6    /* a component that the schedule of the design leaves out */
#define @NAME_UNTOLD 7   /* inputs that are missing */

@SIZES
@TABLES
typedef struct {
@FIELDS
} @name_state;

static inline void @name_init(@name_state *s)
{
    memset(s, 0, sizeof *s);
@START}

/* One measurement. NaN: component missing. */
@SIGNATURE
{
@LINES
    return @NAME_OK;
}
@AFTER@HALVES
#endif

/* {{title}}: see reachlab_policy.h. Written by reachlab {{version}}: change it there. */
#include "reachlab_policy.h"

#include <limits.h>
#include <math.h>

typedef reachlab_real real;

#ifdef REACHLAB_FLOAT
#define R(number) ((real) (number))
#define FUNCTION(name) name##f
#else
#define R(number) (number)
#define FUNCTION(name) name
#endif
#define FMOD FUNCTION(fmod)
#define FABS FUNCTION(fabs)
#define SQRT FUNCTION(sqrt)
#define SIN FUNCTION(sin)
#define COS FUNCTION(cos)
#define TAN FUNCTION(tan)
#define ASIN FUNCTION(asin)
#define ACOS FUNCTION(acos)
#define ATAN FUNCTION(atan)
#define ATAN2 FUNCTION(atan2)
#define EXP FUNCTION(exp)
#define LOG FUNCTION(log)
#define TANH FUNCTION(tanh)
#define POW FUNCTION(pow)
#define FLOOR FUNCTION(floor)
#define CEIL FUNCTION(ceil)
#define RINT FUNCTION(rint)
#define WHOLE(number) \
    (!((number) == (number)) ? 0 : (number) >= R(2147483520.0) ? INT_MAX : (number) <= R(-2147483520.0) ? -INT_MAX : (int) (number))

{{functions}}
static int all_finite(const real *numbers, int count)
{
    int all = 1;
    for (int i = 0; i < count; ++i) all &= isfinite(numbers[i]) != 0;
    return all;
}

int reachlab_reset(reachlab_state *state, const real q[REACHLAB_COMMANDS])
{
    static const real lower[REACHLAB_COMMANDS] = {{lower}}, upper[REACHLAB_COMMANDS] = {{upper}};
    static const reachlab_state rest = { .stop_step = {{rested}} };
    if (!all_finite(q, REACHLAB_COMMANDS)) return REACHLAB_NOT_FINITE;
    for (int i = 0; i < REACHLAB_COMMANDS; ++i)
        if (q[i] < lower[i] - R({{aside}}) || q[i] > upper[i] + R({{aside}})) return REACHLAB_OUTSIDE;
    *state = rest;
    for (int i = 0; i < REACHLAB_COMMANDS; ++i)
        state->position[i] = q[i] < lower[i] ? lower[i] : q[i] > upper[i] ? upper[i] : q[i];
    return REACHLAB_OK;
}

int reachlab_step(reachlab_state *state, const reachlab_input *input, int brake, real command[REACHLAB_COMMANDS])
{
    reachlab_state next = *state;
    real wanted[REACHLAB_COMMANDS];
    int problem = REACHLAB_OK, stops[1] = { brake != 0 };
    for (int i = 0; i < REACHLAB_COMMANDS; ++i) wanted[i] = state->position[i];
    if (!({{checked}})) problem = REACHLAB_NOT_FINITE;
{{outside}}    if (problem == REACHLAB_OK && !brake) {
        decide({{decided}}, next.last_action, wanted{{remembers}});
        if (!all_finite(wanted, REACHLAB_COMMANDS) || !all_finite(next.last_action, {{actions}}){{remembered}}) {
            problem = REACHLAB_NOT_FINITE;
            next = *state;
            for (int i = 0; i < REACHLAB_COMMANDS; ++i) wanted[i] = state->position[i];
        }
    }
    if (problem != REACHLAB_OK) stops[0] = 1;
    advance({{moved}});
    *state = next;
    for (int i = 0; i < REACHLAB_COMMANDS; ++i) command[i] = state->position[i];
    return problem;
}
{{placing}}

/* Steps of an exported policy among hostile inputs: how many times a command left a limit, and how many were refused.
 *
 * limits.h has the limits that were exported, LOWER, UPPER, SPEED, ACCELERATION and JERK. */
#include "limits.h"
#include "reachlab_policy.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static uint64_t state = 88172645463325252u;

/* xorshift64, of G. Marsaglia, 2003. */
static uint64_t next(void)
{
    state ^= state << 13;
    state ^= state >> 7;
    return state ^= state << 17;
}

static double uniform(void)
{
    return (double) (next() >> 11) / 9007199254740992.0;
}

/* A number of everyday size, or one that is not. */
static double number(double odd)
{
    const double kinds[] = { NAN, INFINITY, -INFINITY, 1e308, -1e308, 5e-324, 1e-310, 0.0, -0.0, 1e30, -1e-300 };
    if (uniform() >= odd) return 6 * uniform() - 3;
    return kinds[next() % (sizeof kinds / sizeof *kinds)];
}

/* Whether a difference of commands is beyond its limit, seen past the last bits of the numbers it is of. */
static int beyond(double difference, double limit, int order)
{
    return fabs(difference) / pow(REACHLAB_PERIOD, order) > limit * (1 + 2e-9 + 1e-14 / pow(REACHLAB_PERIOD, order));
}

int main(int count, char **words)
{
    const double shares[] = { 0.0, 0.0, 0.0, 0.01, 0.05, 0.5 };
    static reachlab_state arm;
    double past[4][REACHLAB_COMMANDS] = { { 0 } }, start[REACHLAB_COMMANDS];
    long steps = count == 2 ? atol(words[1]) : 0, broken = 0, refused = 0;
    for (int i = 0; i < REACHLAB_COMMANDS; ++i) start[i] = 0.5 * (LOWER[i] + UPPER[i]);
    start[0] = UPPER[0] + 0.02;
    if (reachlab_reset(&arm, start) != REACHLAB_OUTSIDE) return 2;
    start[0] = UPPER[0] + 0.005; /* as an arm at rest on its limit may be measured */
    if (reachlab_reset(&arm, start) != REACHLAB_OK || arm.position[0] != UPPER[0]) return 2;
    start[0] = 0.5 * (LOWER[0] + UPPER[0]);
    if (reachlab_reset(&arm, start) != REACHLAB_OK) return 2;
    start[REACHLAB_COMMANDS - 1] = NAN;
    if (reachlab_reset(&arm, start) != REACHLAB_NOT_FINITE) return 2;
    for (int k = 0; k < 4; ++k) memcpy(past[k], arm.position, sizeof start);
    for (long step = 0; step < steps; ++step) {
        reachlab_input input;
        double odd = shares[next() % (sizeof shares / sizeof *shares)];
        for (size_t at = 0; at + sizeof(double) <= sizeof input; at += sizeof(double)) {
            double one = number(odd);
            memcpy((char *) &input + at, &one, sizeof one);
        }
        if (uniform() < 0.8) /* else a goal is hardly ever in the workspace */
            for (int i = 0; i < 3; ++i) input.goal_position[i] = GOAL[i] + uniform() * (GOAL[3 + i] - GOAL[i]);
        memmove(past[1], past[0], 3 * sizeof start);
        refused += reachlab_step(&arm, &input, uniform() < 0.02, past[0]) != REACHLAB_OK;
        for (int i = 0; i < REACHLAB_COMMANDS; ++i) {
            double a = past[0][i], b = past[1][i], c = past[2][i], d = past[3][i];
            broken += !(a >= LOWER[i] && a <= UPPER[i]) || beyond(a - b, SPEED[i], 1);
            broken += beyond(a - 2 * b + c, ACCELERATION[i], 2) || beyond(a - 3 * b + 3 * c - d, JERK[i], 3);
        }
    }
    printf("%ld %ld\n", broken, refused);
    return 0;
}

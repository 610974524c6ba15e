/* {{title}}: a policy and its controller in C99. Written by reachlab {{version}} from the functions that it was trained with.
 *
 *     reachlab_state state;
 *     reachlab_reset(&state, q);                          where the arm is measured to rest
 *     problem = reachlab_step(&state, &input, 0, command);    once in a control period of REACHLAB_PERIOD seconds
 *
 * Nothing is allocated, nothing is kept outside of the state, and math.h is all that is needed. Lengths are in m, angles in
 * rad, quaternions w, x, y, z, all of them in the frame of the arm's base. Joints, in their order: {{joints}}.
 * What watches measurements and clocks is not in here: see controller.py beside it.
 */
#ifndef REACHLAB_POLICY_H
#define REACHLAB_POLICY_H

#ifdef REACHLAB_FLOAT
typedef float reachlab_real;
#else
typedef double reachlab_real;
#endif

#define REACHLAB_PERIOD {{period}}
#define REACHLAB_COMMANDS {{commands}}

#ifdef __cplusplus
extern "C" {
#endif

/* What is measured and what is asked for. */
typedef struct {
{{input}}
} reachlab_input;

/* The motion that has been commanded, the last action, and what the policy remembers if it does. */
typedef struct {
{{state}}
    reachlab_real last_action[{{actions}}];{{memory}}
} reachlab_state;

enum { REACHLAB_OK = 0, REACHLAB_NOT_FINITE = 1, REACHLAB_OUTSIDE = 2 };

/* Begins anew with an arm that rests at joints q. Where a number is not finite REACHLAB_NOT_FINITE is returned, and where a
 * joint is more than {{aside}} beyond a limit REACHLAB_OUTSIDE; the state stays as it is: command nothing then. */
int reachlab_reset(reachlab_state *state, const reachlab_real q[REACHLAB_COMMANDS]);

/* The next command, within the limits of position, speed, acceleration and jerk that were exported.
 *
 * They are compiled in: `reachlab export --limits policy.json` writes this anew with those that were lowered there. If brake
 * is not 0, or a number of the input or of the policy's command is not finite{{asked}},
 * the arm is brought to rest on a way that keeps the limits; REACHLAB_NOT_FINITE or REACHLAB_OUTSIDE is returned then. */
int reachlab_step(reachlab_state *state, const reachlab_input *input, int brake, reachlab_real command[REACHLAB_COMMANDS]);
{{place}}
#ifdef __cplusplus
}
#endif
#endif

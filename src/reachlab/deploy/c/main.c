/* Reads a log that Controller.save_log wrote, and prints the command of each of its steps:
 *
 *     cc -O2 -o policy main.c reachlab_policy.c -lm && ./policy log.jsonl
 *
 * They are the controller's own where it had good measurements and knew the joints of its goal at once: it looks for
 * those of a pose over several steps, in which this example is ahead of it.
 *
 * A loop of your own fills reachlab_input from what it measures in place of what stands in the log. */
#include "reachlab_policy.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Numbers that stand behind a name in a line of JSON; how many there are. */
static int numbers(const char *line, const char *name, reachlab_real *values, int most)
{
    char key[64];
    int count = 0;
    snprintf(key, sizeof key, "\"%s\": [", name);
    const char *at = strstr(line, key);
    if (!at) return 0;
    for (at += strlen(key); count < most; ++count) {
        char *end;
        double value = strtod(at, &end);
        if (end == at) break;
        values[count] = (reachlab_real) value;
        at = end + strspn(end, ", ");
    }
    return count;
}

int main(int count, char **words)
{
    static char line[65536];
    static reachlab_state state;
    static reachlab_input input;
    static const reachlab_real home[REACHLAB_COMMANDS] = { {{home}} };
    int begun = 0, stopped = 0;
    FILE *log = count == 2 ? fopen(words[1], "r") : NULL;
    if (!log) {
        if (count == 2) perror(words[1]);
        else fprintf(stderr, "usage: policy LOG, of Controller.save_log\n");
        return 2;
    }
{{refused}}    while (fgets(line, sizeof line, log)) {
        reachlab_real q[REACHLAB_COMMANDS], goal[7] = { 0 }, command[REACHLAB_COMMANDS];
        if (strstr(line, "\"reset\": ")) { /* without joints a controller begins at home */
            int told = numbers(line, "reset", q, REACHLAB_COMMANDS) == REACHLAB_COMMANDS;
            begun = reachlab_reset(&state, told ? q : home) == REACHLAB_OK;
            stopped = 0;
            continue;
        }
        stopped |= strstr(line, "\"stop\": ") != NULL;
        if (!begun || strstr(line, "\"stop\": ")) continue;
        numbers(line, "q", input.q, (int) (sizeof input.q / sizeof *input.q));
        numbers(line, "qd", input.qd, (int) (sizeof input.qd / sizeof *input.qd));
        int brake = stopped | !numbers(line, "goal", goal, 7);
{{goal}}
        brake |= reachlab_step(&state, &input, brake, command);
        for (int i = 0; i < REACHLAB_COMMANDS; ++i) printf("%.17g%c", command[i], i + 1 < REACHLAB_COMMANDS ? ' ' : '\n');
    }
    fclose(log);
    if (!begun) fprintf(stderr, "%s is no log of Controller.save_log that has a reset\n", words[1]);
    return begun ? 0 : 2;
}

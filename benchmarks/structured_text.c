/* Calls an exported block with its vectors; structured_text.py fills in the block. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
%(before)s
static double v[%(samples)d][%(columns)d], shortest[%(samples)d]; static %(type)s block; static struct timespec t;
static void call(const double *v) { if (v[0]) { %(reset)s; } %(inputs)s %(step)s; }
static double now(void) { clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t); return 1e6 * t.tv_sec + 1e-3 * t.tv_nsec; }
int main(void)
{
    double largest = 0.0, best = HUGE_VAL, longest = 0.0;
    for (int n = 0; n < %(samples)d; shortest[n++] = HUGE_VAL)
        for (int i = 0; i < %(columns)d; ++i) { char text[64]; scanf("%%63s", text); v[n][i] = strtod(text, NULL); }
    for (int n = 0, row = -1; n < %(samples)d; ++n) {
        call(v[n]);
        if (v[n][0]) row = -1;
        if (row < 0 && %(due)s) row = n; /* a window that ends during the work on another one is left out */
        const double found[] = { %(outputs)s };
        if (!(%(fresh)s)) continue;
        for (int i = %(first)d; i < %(columns)d; ++i) {
            const double apart = fabs(found[i - %(first)d] - v[row][i]);
            if (!(apart <= largest)) largest = apart > largest ? apart : HUGE_VAL;
        }
        row = -1;
    }
    for (int round = 0; round < 7; ++round) {
        double begun = now();
        for (int k = 0; k < 20; ++k) for (int n = 0; n < %(samples)d; ++n) call(v[n]);
        best = fmin(best, (now() - begun) / 20 / %(samples)d);
        for (int n = 0; n < %(samples)d; ++n) { begun = now(); call(v[n]); shortest[n] = fmin(shortest[n], now() - begun); }
    }
    for (int n = 0; n < %(samples)d; ++n) longest = fmax(longest, shortest[n]);
    printf("%%.3g %%.4g %%.4g %%d\n", largest, best, longest, (int)sizeof block);
}

/* Loads the binary of an FMU that the command line names, and prints position and pressure in every period. */
#include <stdio.h>
#include <stdlib.h>
#ifdef _WIN32
#include <windows.h>
#define OPEN(file) LoadLibraryA(file)
#define NAMED(library, name) GetProcAddress(library, name)
#else
#include <dlfcn.h>
#define OPEN(file) dlopen(file, RTLD_NOW)
#define NAMED(library, name) dlsym(library, name)
#endif
typedef unsigned int Reference;
static void logger(void *e, const char *n, int s, const char *c, const char *m, ...) { (void)e; (void)s; puts(m); }
typedef struct { void *logger, *allocate, *release, *finished, *environment; } Callbacks;
int main(int count, char **words)
{
    void *library = count > 1 ? (void *)OPEN(words[1]) : NULL;
    if (!library)
        return 3;
    void *(*make)(const char *, int, const char *, const char *, const Callbacks *, int, int) =
        (void *(*)(const char *, int, const char *, const char *, const Callbacks *, int, int))
            NAMED(library, "fmi2Instantiate");
    int (*begin)(void *) = (int (*)(void *))NAMED(library, "fmi2EnterInitializationMode");
    int (*begun)(void *) = (int (*)(void *))NAMED(library, "fmi2ExitInitializationMode");
    int (*set)(void *, const Reference *, size_t, const double *) =
        (int (*)(void *, const Reference *, size_t, const double *))NAMED(library, "fmi2SetReal");
    int (*get)(void *, const Reference *, size_t, double *) =
        (int (*)(void *, const Reference *, size_t, double *))NAMED(library, "fmi2GetReal");
    int (*advance)(void *, double, double, int) = (int (*)(void *, double, double, int))NAMED(library, "fmi2DoStep");
    Callbacks callbacks = {(void *)logger, (void *)calloc, (void *)free, NULL, NULL};
    void *axis = make("axis", 1, IDENTITY, "", &callbacks, 0, 0);
    const Reference place = INITIAL_POSITION, voltage = VOLTAGE, seen[2] = {POSITION, PRESSURE_A};
    const double start = START;
    double values[2];
    if (!axis || begin(axis) || set(axis, &place, 1, &start) || begun(axis))
        return 4;
    for (int sample = 0; sample < SAMPLES; ++sample) {
        const double command = sample < 20 ? 1.0 : -2.0;
        if (set(axis, &voltage, 1, &command) || advance(axis, sample * PERIOD, PERIOD, 1) || get(axis, seen, 2, values))
            return 5;
        printf("%.17g %.17g\n", values[0], values[1]);
    }
    return 0;
}

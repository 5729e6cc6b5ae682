/* Functions that Structured Text lacks; beyond 20 the hyperbolic tangent is 1 to the last digit. */
static void fill(double *array, long count, double value) { long i; for (i = 0; i < count; ++i) array[i] = value; }
static void memcpy(double *to, double *from, long count) { long i; for (i = 0; i < count; ++i) to[i] = from[i]; }
static int isfinite(double x) { return fabs(x) < 1e30; }
static double minimum(double a, double b) { return b < a ? b : a; }
static double maximum(double a, double b) { return b > a ? b : a; }
static double hypot(double a, double b) { return sqrt(a * a + b * b); }
static double tanh(double x) { return 1.0 - 2.0 / (exp(2.0 * minimum(maximum(x, -20.0), 20.0)) + 1.0); }
static double asinh(double x)
{
    double size;
    size = log(fabs(x) + sqrt(x * x + 1.0));
    return x < 0.0 ? -size : size;
}

/* Scalar statements about two frames z = (p_a, directors of a, p_b, directors of b), with gradient and Hessian.

     MEET            u . (p_b - p_a), u fixed in the ground        PERPENDICULAR   u_a . w_b
     WITHIN          v_b . w_b                                     ALONG           u_a . (p_b - p_a)
     ANGLE           atan2(v_a . w_b, u_a . w_b), the turn that is nearest to one that is known
     DISTANCE        |p_b - p_a|                                   FOLLOWING       no measure but the direction w_b on p_b

   written by pgmp_petsc */

#include <math.h>
#include <string.h>

#include "tables.h"

#define DIRECTOR(first, k, c) ((first) + D + D * (k) + (c))
enum { U, V, W };

static double component(const double axis[D], const double *z, int first, int c) {
    double total = 0.0;
    for (int k = 0; k < D; k++) total += axis[k] * z[DIRECTOR(first, k, c)];
    return total;
}

static double distance(const double z[2 * N_FRAME], double gradient[], double (*hessian)[2 * N_FRAME]) {
    double e[D], square = 0.0;
    for (int c = 0; c < D; c++) e[c] = z[N_FRAME + c] - z[c], square += e[c] * e[c];
    double length = sqrt(square);
    if (!(length > 0.0)) return length; /* where the points meet it has no direction */
    for (int c = 0; c < D; c++) {
        e[c] /= length;
        gradient[c] = -e[c], gradient[N_FRAME + c] = e[c];
    }
    for (int i = 0; hessian && i < D; i++)
        for (int j = 0; j < D; j++) {
            double across = ((i == j) - e[i] * e[j]) / length;
            hessian[i][j] = hessian[N_FRAME + i][N_FRAME + j] = across;
            hessian[i][N_FRAME + j] = hessian[N_FRAME + i][j] = -across;
        }
    return length;
}

/* With (cos, sin) = r (u_a . w_b, v_a . w_b), g the gradient and m that of log r, the second derivatives are
   (cos d2 sin - sin d2 cos) / r - g m^T - m g^T. */
static double angle(const double (*axes)[D], const double z[2 * N_FRAME], double turned, double gradient[],
                    double (*hessian)[2 * N_FRAME]) {
    double cosine = 0.0, sine = 0.0, stretch[2 * N_FRAME] = {0};
    for (int c = 0; c < D; c++) {
        double w = component(axes[W], z, N_FRAME, c);
        cosine += component(axes[U], z, 0, c) * w;
        sine += component(axes[V], z, 0, c) * w;
    }
    double found = atan2(sine, cosine), r = sqrt(cosine * cosine + sine * sine), whole = 6.283185307179586;
    cosine /= r, sine /= r;
    for (int c = 0; c < D; c++) {
        double u = component(axes[U], z, 0, c), v = component(axes[V], z, 0, c);
        double w = component(axes[W], z, N_FRAME, c);
        for (int k = 0; k < D; k++) {
            int in_a = DIRECTOR(0, k, c), in_b = DIRECTOR(N_FRAME, k, c);
            double across = cosine * axes[V][k] - sine * axes[U][k], level = cosine * axes[U][k] + sine * axes[V][k];
            gradient[in_a] = across * w / r, stretch[in_a] = level * w / r;
            gradient[in_b] = axes[W][k] * (cosine * v - sine * u) / r;
            stretch[in_b] = axes[W][k] * (cosine * u + sine * v) / r;
            for (int j = 0; hessian && j < D; j++) {
                int other = DIRECTOR(N_FRAME, j, c);
                hessian[in_a][other] = hessian[other][in_a] = across * axes[W][j] / r;
            }
        }
    }
    for (int i = 0; hessian && i < 2 * N_FRAME; i++)
        for (int j = 0; j < 2 * N_FRAME; j++) hessian[i][j] -= gradient[i] * stretch[j] + stretch[i] * gradient[j];
    return found + whole * floor((turned - found) / whole + 0.5);
}

/* Value of a statement; gradient (2 N_FRAME) and, unless it is NULL, Hessian are filled. */
double evaluate_statement(const struct statement *of, const double z[2 * N_FRAME], double turned, double gradient[],
                          double (*hessian)[2 * N_FRAME]) {
    const double(*axes)[D] = of->axes;
    double s = 0.0;
    memset(gradient, 0, 2 * N_FRAME * sizeof(double));
    if (hessian) memset(hessian, 0, 4 * N_FRAME * N_FRAME * sizeof(double));
    if (of->kind == DISTANCE) return distance(z, gradient, hessian);
    if (of->kind == ANGLE) return angle(axes, z, turned, gradient, hessian);
    for (int c = 0; c < D; c++) {
        double apart = z[N_FRAME + c] - z[c];
        if (of->kind == MEET) {
            gradient[c] = -axes[U][c], gradient[N_FRAME + c] = axes[U][c];
            s += axes[U][c] * apart;
        }
        for (int k = 0; k < D; k++) {
            int in_a = DIRECTOR(0, k, c), in_b = DIRECTOR(N_FRAME, k, c);
            if (of->kind == FOLLOWING) {
                gradient[N_FRAME + c] += axes[W][k] * z[in_b];
                if (hessian) hessian[N_FRAME + c][in_b] = axes[W][k];
            } else if (of->kind == ALONG) {
                double u = axes[U][k];
                s += u * z[in_a] * apart;
                gradient[in_a] = u * apart;
                gradient[c] -= u * z[in_a];
                gradient[N_FRAME + c] += u * z[in_a];
                if (hessian) {
                    hessian[c][in_a] = hessian[in_a][c] = -u;
                    hessian[N_FRAME + c][in_a] = hessian[in_a][N_FRAME + c] = u;
                }
            } else if (of->kind != MEET) { /* PERPENDICULAR: u in a, WITHIN: v in b; both with w in b */
                int one = of->kind == WITHIN ? in_b : in_a;
                double in_one = axes[of->kind == WITHIN ? V : U][k];
                for (int j = 0; j < D; j++) {
                    int other = DIRECTOR(N_FRAME, j, c);
                    double factor = in_one * axes[W][j];
                    s += factor * z[one] * z[other];
                    gradient[one] += factor * z[other];
                    gradient[other] += factor * z[one];
                    if (hessian) hessian[one][other] += factor, hessian[other][one] += factor;
                }
            }
        }
    }
    return s;
}

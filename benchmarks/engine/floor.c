/* Steps of the reduced model with one rigid coordinate in bare C: the same arithmetic, and nothing else.

   No refilling of cells, no fates of samples, no local effects, no trail; sizes are constants of the compiler. Blocks of
   LANES samples go through all steps one after the other. See `benchmarks.engine.floor`, which compiles and calls it. */

#include <math.h>

#define POWERS 4        /* of the tables of flexible coordinates */
#define RIGID_POWERS 8  /* of the rigid inertia */
#define N (M + 1)
#define PACKED(n) ((n) * ((n) + 1) / 2)

typedef double vec __attribute__((vector_size(8 * LANES)));

enum {
    COUPLING = PACKED(N),
    STIFFNESS = COUPLING + M,
    CUBIC = STIFFNESS + PACKED(M),
    SWING = CUBIC + (SECOND_ORDER ? M * (M + 1) * (M + 2) / 6 : 0),
    GYROSCOPIC = SWING + (SECOND_ORDER ? PACKED(M) : 0),
    END = GYROSCOPIC + (SECOND_ORDER ? M * (M - 1) / 2 : 0),
    LOAD_END = N + (SECOND_ORDER ? PACKED(M) : 0),
};

/* What is kept of a block: polynomials of its cell, and its state. */
struct block {
    vec rigid[RIGID_POWERS], terms[END][POWERS], loads[LOAD_END][POWERS];
    vec q[N], v[N], a[N], auxiliary[N], before[N];
};

int block_size(void) { return sizeof(struct block); }

static inline vec value_and_slope(const vec *c, vec s, vec *slope) {
    vec t = c[3] * s, u = c[2] + t, w = c[1] + s * u;
    *slope = w + s * (u + t);
    return c[0] + s * w;
}

static inline vec absolute(vec x) {
    for (int lane = 0; lane < LANES; lane++) x[lane] = fabs(x[lane]);
    return x;
}

static inline vec largest(vec x, vec y) {
    for (int lane = 0; lane < LANES; lane++) x[lane] = x[lane] > y[lane] ? x[lane] : y[lane];
    return x;
}

/* Residual and iteration matrix at (q, v, a), and the Newton correction. */
static void correct(const struct block *b, const vec q[N], const vec v[N], const vec a[N], double amplitude,
                    double gain_v, double gain_a, double lower, vec r[N]) {
    const vec zero = {0};
    vec s = q[0] - lower, v0 = v[0], a0 = a[0], v00 = v0 * v0;
    vec moved[N], turned[M], pulled[N], column[M], row[M], factor[PACKED(M)], skew[PACKED(M)], corner;
    vec mass = zero, slope = zero;
    for (int p = RIGID_POWERS - 1; p >= 0; p--) {
        slope = slope * s + mass;
        mass = mass * s + b->rigid[p];
    }
    r[0] = mass * a0;
    moved[0] = slope * v0;
    pulled[0] = slope * a0;
    corner = gain_a * mass + gain_v * (slope * v0);
    for (int i = 0, entry = 0; i < M; i++) {
        int at = PACKED(i + 1);
        vec ai = a[i + 1], vi = v[i + 1], qi = q[i + 1];
        vec m = value_and_slope(b->terms[at], s, &slope);
        vec total = m * a0, change = slope * v0, pull = slope * a0, turn = zero;
        r[0] += m * ai;
        moved[0] += slope * vi;
        pulled[0] += slope * ai;
        column[i] = row[i] = gain_a * m + gain_v * (slope * v0);
        for (int j = 0; j <= i; j++, entry++) {
            vec bends, dm, mij = value_and_slope(b->terms[at + 1 + j], s, &dm);
            vec kij = value_and_slope(b->terms[STIFFNESS + entry], s, &bends);
            total += mij * a[j + 1] + kij * q[j + 1];
            change += dm * v[j + 1];
            turn += bends * q[j + 1];
            pull += dm * a[j + 1];
            if (j < i) {
                r[j + 1] += mij * ai + kij * qi;
                moved[j + 1] += dm * vi;
                turned[j] += bends * qi;
                pulled[j + 1] += dm * ai;
            }
            factor[entry] = gain_a * mij + gain_v * (dm * v0) + kij;
        }
        r[i + 1] = total, moved[i + 1] = change, turned[i] = turn, pulled[i + 1] = pull;
    }
    vec twice = zero, bending = zero, leaning = zero, load[LOAD_END], load_slope[LOAD_END];
    for (int i = 0; i < LOAD_END; i++) {
        load[i] = amplitude * value_and_slope(b->loads[i], s, &slope);
        load_slope[i] = amplitude * slope;
    }
    for (int i = 0; i < N; i++) {
        r[i] += v0 * moved[i] - load[i];
        twice += v[i] * moved[i];
    }
    for (int i = 0; i < M; i++) {
        bending += q[i + 1] * turned[i];
        leaning += q[i + 1] * load_slope[i + 1];
        turned[i] -= load_slope[i + 1];
        column[i] += turned[i] + gain_v * moved[i + 1] + pulled[i + 1];
        row[i] += turned[i] - gain_v * moved[i + 1];
    }
    r[0] += 0.5 * (bending - twice) - leaning;
    corner += pulled[0];
    vec leant = zero, swung = zero, turning = zero, turning_on = zero;
    for (int i = 0; i < M; i++) {
        vec db, c = value_and_slope(b->terms[COUPLING + i], s, &db);
        r[i + 1] -= c * v00;
        leant += c * q[i + 1];
        swung += c * v[i + 1];
        turning += db * q[i + 1];
        turning_on += db * v[i + 1];
        column[i] -= 2.0 * gain_v * (c * v0) + db * v00;
        row[i] += 2.0 * (c * (gain_v * v0 + a0) + db * v0 * v0) - db * v00;
    }
    r[0] += 2.0 * (leant * a0 + swung * v0 + turning * v00) - turning * v00;
    corner += 2.0 * (leant * gain_a + gain_v * (swung + turning * v0));
    corner += 2.0 * (turning * a0 + turning_on * v0);
    if (SECOND_ORDER) {
        vec bent[PACKED(M)], cubic = zero, along[M], across[M], energy = zero, held = zero, moving = zero;
        for (int e = 0; e < PACKED(M); e++) bent[e] = zero;
        const vec(*t)[POWERS] = b->terms + CUBIC;
        for (int i = 0; i < M; i++)
            for (int j = 0; j <= i; j++) {
                vec part = zero, last = zero;
                for (int k = 0; k <= j; k++, t++) {
                    vec d, w = value_and_slope(*t, s, &d);
                    bent[PACKED(i) + j] += w * q[k + 1];
                    if (k < j) bent[PACKED(i) + k] += w * q[j + 1];
                    if (j < i) bent[PACKED(j) + k] += w * q[i + 1];
                    if (k < j)
                        part += d * q[k + 1];
                    else
                        last = d * q[k + 1];
                }
                cubic += (j < i ? 6.0 * part + 3.0 * last : 3.0 * part + last) * (q[i + 1] * q[j + 1]);
            }
        r[0] += cubic / 6.0;
        vec leaning2 = zero;
        for (int i = 0; i < M; i++) along[i] = across[i] = zero;
        for (int i = 0, e = 0; i < M; i++)
            for (int j = 0; j <= i; j++, e++) {
                vec dc, c = value_and_slope(b->terms[SWING + e], s, &dc), both = q[i + 1] * q[j + 1];
                vec stiff = 0.5 * bent[e] - load[N + e];
                if (j < i) both += both;
                energy += dc * both;
                leaning2 += load_slope[N + e] * both;
                along[i] += c * q[j + 1];
                across[i] += stiff * q[j + 1];
                if (j < i) {
                    along[j] += c * q[i + 1];
                    across[j] += stiff * q[i + 1];
                }
                factor[e] += bent[e] - load[N + e] + v00 * c;
            }
        for (int i = 0; i < M; i++) {
            held += q[i + 1] * along[i];
            moving += v[i + 1] * along[i];
            r[i + 1] += across[i] + v00 * along[i];
            column[i] += 2.0 * gain_v * (v0 * along[i]);
            row[i] -= 2.0 * ((gain_v * v0 + a0) * along[i]);
            along[i] = across[i] = zero;
        }
        r[0] += 0.5 * (v00 * energy - leaning2) - (held * a0 + 2.0 * moving * v0 + energy * v00);
        corner -= gain_a * held + 2.0 * gain_v * moving;
        vec pushed = a0 + 2.0 * gain_v * v0, changing = zero, total = zero;
        for (int i = 0, e = 0; i < M; i++)
            for (int j = 0; j < i; j++, e++) {
                vec d, w = value_and_slope(b->terms[GYROSCOPIC + e], s, &d), change = d * v0;
                along[i] += w * q[j + 1];
                along[j] -= w * q[i + 1];
                across[i] += 2.0 * w * v[j + 1] + change * q[j + 1];
                across[j] -= 2.0 * w * v[i + 1] + change * q[i + 1];
                changing += d * (v[i + 1] * q[j + 1] - v[j + 1] * q[i + 1]);
                skew[PACKED(i) + j] = -(w * pushed + v0 * change);
            }
        for (int i = 0; i < M; i++) {
            r[i + 1] -= a0 * along[i] + v0 * across[i];
            total += a[i + 1] * along[i];
            column[i] -= gain_a * along[i];
            row[i] -= gain_a * along[i];
        }
        r[0] += changing * v0 - total - changing * v0;
    }
    vec *low = factor, *up = SECOND_ORDER ? skew : factor;
    for (int i = 0; SECOND_ORDER && i < M; i++)
        for (int j = 0; j < i; j++) {
            vec even = low[PACKED(i) + j], odd = up[PACKED(i) + j];
            low[PACKED(i) + j] = even + odd;
            up[PACKED(i) + j] = even - odd;
        }
    for (int k = 0; k < M; k++) {
        vec inverse = 1.0 / low[PACKED(k) + k];
        low[PACKED(k) + k] = inverse;
        for (int i = k + 1; i < M; i++) {
            vec down = low[PACKED(i) + k], across = up[PACKED(i) + k];
            low[PACKED(i) + k] = down * inverse;
            if (SECOND_ORDER) up[PACKED(i) + k] = across * inverse;
            for (int j = k + 1; j < i; j++) {
                low[PACKED(i) + j] -= down * up[PACKED(j) + k];
                if (SECOND_ORDER) up[PACKED(i) + j] -= across * low[PACKED(j) + k];
            }
            low[PACKED(i) + i] -= down * (across * inverse);
            column[i] -= low[PACKED(i) + k] * column[k];
            row[i] -= up[PACKED(i) + k] * row[k];
        }
        row[k] *= inverse;
        corner -= row[k] * column[k];
    }
    for (int i = 0; i < M; i++)
        for (int j = 0; j < i; j++) r[i + 1] -= low[PACKED(i) + j] * r[j + 1];
    for (int i = 0; i < M; i++) r[0] -= row[i] * r[i + 1];
    r[0] /= corner;
    for (int i = M - 1; i >= 0; i--) {
        vec total = (r[i + 1] - column[i] * r[0]) * low[PACKED(i) + i];
        for (int j = i + 1; j < M; j++) total -= up[PACKED(j) + i] * r[j + 1];
        r[i + 1] = total;
    }
}

/* Take blocks through steps of the generalised-alpha scheme with one correction each; return the largest correction. */
double advance(struct block *blocks, int n_blocks, int n_steps, double step, const double scheme[6], double amplitude,
               double lower) {
    double alpha_m = scheme[0], alpha_f = scheme[1], beta = scheme[2], gamma = scheme[3];
    double gain_v = scheme[4], gain_a = scheme[5], weight = 1.0 / (1.0 - alpha_m);
    vec size = {0};
    for (struct block *b = blocks; b < blocks + n_blocks; b++)
        for (int number = 0; number < n_steps; number++) {
            vec q[N], v[N], a[N], r[N];
            for (int i = 0; i < N; i++) {
                a[i] = 2.0 * b->a[i] - b->before[i];
                vec ahead = ((1.0 - alpha_f) * a[i] + alpha_f * b->a[i] - alpha_m * b->auxiliary[i]) * weight;
                q[i] = b->q[i] + step * b->v[i] + step * step * ((0.5 - beta) * b->auxiliary[i] + beta * ahead);
                v[i] = b->v[i] + step * ((1.0 - gamma) * b->auxiliary[i] + gamma * ahead);
            }
            correct(b, q, v, a, amplitude, gain_v, gain_a, lower, r);
            for (int i = 0; i < N; i++) {
                size = largest(size, absolute(r[i]));
                a[i] -= gain_a * r[i];
                b->q[i] = q[i] - r[i];
                b->v[i] = v[i] - gain_v * r[i];
                b->before[i] = b->a[i];
                b->auxiliary[i] = ((1.0 - alpha_f) * a[i] + alpha_f * b->a[i] - alpha_m * b->auxiliary[i]) * weight;
                b->a[i] = a[i];
            }
        }
    double found = 0.0;
    for (int lane = 0; lane < LANES; lane++) found = found > size[lane] ? found : size[lane];
    return found;
}

/* A component model: bodies along a tree of joints, each in the frame that moves with it.

   written by pgmp_petsc */

#ifndef PGMP_EQUATIONS_H
#define PGMP_EQUATIONS_H

/* N coordinates: what the tree's joints turn and slide, and amplitudes of the bodies, body by body; N_LEFT constraints that
   the tree leaves, with a multiplier each. */
#define N_ALL (N + N_LEFT)
#define N_TURNS (D == 2 ? 1 : 3)
#define SYMMETRIC 1 /* the matrix of the iteration, see actions.c */
#define OF_OLD_FACTORS 1.0 /* what a second correction leaves is as estimated */

struct own {
    double table[AT_LEAST_ONE(N_WORDS)], densities[AT_LEAST_ONE(N_MASSES)][1 + D][1 + D], gravity[AT_LEAST_ONE(N_GRAVITY)][D];
    double loads[AT_LEAST_ONE(N_LOAD_TERMS)];
    double turned[R + N_PARTS]; /* what angles are near to: of the measured coordinates, and of the parts of effects */
};

#ifdef PGMP_TABLES_H /* what is no concern of those who call the model */

enum { BY_AXES, BALL, FREE };
/* A body of the tree: how it moves on the one before it, nodes of the frame that its joint is on, -1 on the ground, that it
   holds, and that moves with the body; its coordinates, -1 where it has none; its faces, words of its table, -1 of a rigid one, and entries of
   its matrices, and whether it follows its foreshortening; damping by stiffness and by mass; and place and triad of the joint in both frames. In the plane `rest` is
   how far the held frame is turned where the joint is not. */
struct body {
    int kind, on, held, base, turning, sliding, natural, first, n, faces, last_face, table, rows, columns, curved;
    double beta, alpha, rest, before[1 + D][D], after[1 + D][D];
};
/* A face of a flexible body: its node and centre, and where displacements and rotations per amplitude begin in `shapes`,
   and rows of their derivatives with the amplitudes, -1 where there are none. */
struct face { int node, shapes, bends; double centre[D]; };
struct mass { int node; double alpha; };
/* An entry of a load term: on a component of a node's frame, in the plane 2 turns it, or without a node on a coordinate. */
struct push { int term, node, component; double value; };
/* A measured coordinate whose motion is given: the coordinate of the tree, and whether it grows with it, 1 or -1. */
struct drive { int coordinate, measured; double sign; };

/* A constraint: its value, and the measured coordinate whose motion it takes besides, -1 of none. */
struct bond { double wanted; int motion; };

/* What a joint of the tree holds of the body that it moves, or what drives it, the gap whose multiplier that is, -1 of none
   that is read, and its statement among the terms of the constraints. */
struct hold { int body, gap, term; };

extern const struct hold holds[];
extern const int left_of_gap[]; /* the constraint whose multiplier a gap has, -1 of what the tree holds */
extern const int owners[], behind[]; /* the body that each node is on, and the first one that a body does not carry */
extern const struct body tree[N_TREE];
extern const struct face faces[];
extern const struct mass masses[];
extern const struct push pushes[];
extern const struct drive drives[];
extern const struct bond bonds[];
extern const int curve_rows[], curve_columns[];
extern const double shapes[], curves[], moments[N_TERMS][AT_LEAST_ONE(N_WORDS)];
extern const double densities[N_TERMS][AT_LEAST_ONE(N_MASSES)][1 + D][1 + D], gravity[N_TERMS][AT_LEAST_ONE(N_GRAVITY)][D];
extern const double start_turned[], body_centres[N_BODIES][D];
extern const int first_entries[], columns[], gravity_strengths[], body_nodes[];

/* A frame, its rate, its acceleration, and its derivatives with the first n coordinates; in the plane its angle too. */
enum { AT, RATE, MORE, SLOPES };
struct chain { double z[SLOPES + N][N_FRAME], angle; int n; };

struct matrix { double a[N_ALL][N_ALL]; int order[N_ALL]; };
/* The largest rotation of a face, and how fast nodes move and are accelerated at most. */
struct look { double rotation, speed, pull; };

struct side;
struct acting;
struct pgmp_model;
/* Frames of all nodes; returns the largest rotation of a face. */
double place(const double q[N], const double v[N], const double a[N], struct chain nodes[N_NODES]);
/* A column of the frame of a point: see `chain`. */
void attach_column(const struct side *side, const struct chain nodes[N_NODES], int column, double z[N_FRAME]);
/* The residual r at accelerations as of `find_forces`, the forces on frames that it has of all but local effects, and the
   multipliers of the constraints that are left. */
void find_residual(struct pgmp_model *m, const struct acting *now, const double *own, struct chain nodes[N_NODES],
                   double on_frames[N_NODES][N_FRAME], double left[], double r[N_ALL]);

#endif

#endif

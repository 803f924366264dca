/* Constant tables of the model, in tables.c.

   written by pgmp_petsc */

#ifndef PGMP_TABLES_H
#define PGMP_TABLES_H

#include "model.h"

struct piece { double begin, origin, cubic[4], wave[3]; };
/* A point of a body: slot of its node among the output nodes, -1 on the ground; point and arm in the body's frame. */
struct side { int slot, body; double point[2], arm[2]; };
struct output { int kind, axis, in_body; struct side a, b; double x, y; };
struct damper { int a, b; }; /* slots of the nodes of the joint, -1 on the ground */
enum { ANGLE, ROTATION, POSITION, DEFORMATION, DISTANCE, SLIDING };

extern const double rigid_table[N_CELLS][N_TERMS][RIGID_POWERS], terms_table[N_ROWS][N_TERMS][END];
extern const double loads_table[AT_LEAST_ONE(N_LOAD_TERMS)][N_ROWS][LOAD_END];
extern const double shapes_table[N_ROWS][N_FACTORS][N_SHAPES], branch_table[3][N_BRANCH][N_BODIES][3];
extern const int load_of_term[];
extern const double parameter_values[], parameter_lower[], parameter_upper[], scale[], winding[], node_points[][2];
extern const int node_bodies[], load_pieces[];
extern const struct piece pieces[];
extern const struct output outputs[];
extern const struct damper dampers[];
void weigh(const double *p, double *terms, double *loads, double *dampers);

#endif

"""What reads each kind of result; reduced models and shards have readers of their own."""

from __future__ import annotations

from pgmp_petsc.results.derivatives import Derivatives
from pgmp_petsc.results.designs import Design
from pgmp_petsc.results.ensemble import Ensemble
from pgmp_petsc.results.fit import Fit
from pgmp_petsc.results.modes import ModesTable
from pgmp_petsc.results.rare_event import RareEvent
from pgmp_petsc.results.tradeoff import Tradeoff
from pgmp_petsc.results.trajectory import Trajectory

READERS = {
    kind.kind: kind for kind in (ModesTable, Trajectory, Ensemble, Tradeoff, Derivatives, Fit, Design, RareEvent)
}

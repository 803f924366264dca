"""Joints that couple the motions of others: gears, belts, racks, screws, cams, and any sum of motions.

With the motions s_i of joints, turning (rad) or sliding (m), a coupling holds

    sum_i r_i s_i = const.

The factors r_i may be parameters. The rigid motion depends on them as it does on lengths (`scene.uses`).
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from pgmp_petsc.scene.fields import Name, NotZeroOrParameter, OrFile, Pair, PositivePair, TwoNames, Unit, Use, refusal
from pgmp_petsc.scene.joints import CouplingEntry, Share

CLOSED = 1e-9  # rad that the period of a cam may be off, and share of its lift that its ends may differ by
FEWEST_POINTS = 4  # of a cam; fewer have no spline to speak of


def _closed(table: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    angles, lifts = zip(*table)
    late = next((k for k in range(1, len(angles)) if angles[k] <= angles[k - 1]), None)
    if late is not None:
        raise refusal(f"angles must increase; {angles[late]:g} follows {angles[late - 1]:g}")
    if abs(angles[-1] - angles[0] - 2.0 * math.pi) > CLOSED:
        raise refusal(f"must span one turn, 2 pi = {2.0 * math.pi!r} rad; it spans {angles[-1] - angles[0]!r}")
    if abs(lifts[-1] - lifts[0]) > CLOSED * max(map(abs, lifts)):
        raise refusal(f"must close: its last value is that of the first angle, {lifts[0]:g}; it is {lifts[-1]:g}")
    return table


def _geared(joints: tuple[str, str], ratio: float | str) -> list[Share]:
    """Return ``s_2 - ratio s_1`` of two joints that turn."""
    first, second = joints
    return [Share(second, "turning", "joints"), Share(first, "turning", "joints", ratio, -1.0)]


class Gear(CouplingEntry):
    """Two joints turn in a ratio: the turning of the second is the ratio times that of the first, from the placements
    on."""

    type: Literal["gear"]
    dimensions = (2, 3)
    joints: TwoNames = Field(description="names of two joints that turn")
    ratio: Annotated[NotZeroOrParameter, Unit("1")] = Field(
        description="rad of the second for each rad of the first; negative where they turn against"
    )

    def shares(self, motion):
        """Return ``s_2 - ratio s_1``."""
        return _geared(self.joints, self.ratio)


class Belt(CouplingEntry):
    """Two joints turn with the pulleys of a belt that neither slips nor stretches: as much of it runs off one as runs
    on to the other, from the placements on."""

    type: Literal["belt"]
    one_of = ("radii", "ratio")
    loose = ""
    dimensions = (2, 3)
    joints: TwoNames = Field(description="names of two joints that turn")
    radii: Annotated[PositivePair | None, Unit("m")] = Field(
        None, description="radius of the pulley on each (m), numbers or parameters' names"
    )
    ratio: Annotated[NotZeroOrParameter | None, Unit("1")] = Field(
        None, description="in place of radii: rad of the second for each rad of the first, as of a gear"
    )
    crossed: bool = Field(
        False,
        strict=True,
        description="whether the belt over the radii is crossed, so that its pulleys turn against one another",
    )

    def check_entries(self) -> None:
        if self.crossed and self.ratio is not None:
            raise refusal("a ratio says it by its sign: negative where the pulleys turn against one another", "crossed")

    def shares(self, motion):
        """Return ``r_2 s_2 - r_1 s_1``, or the sum if it is crossed; with a ratio that of a gear."""
        if self.radii is None:
            return _geared(self.joints, self.ratio)
        (first, second), (of_first, of_second) = self.joints, self.radii
        turning = Share(first, "turning", "joints", of_first, 1.0 if self.crossed else -1.0)
        return [Share(second, "turning", "joints", of_second), turning]


class Rack(CouplingEntry):
    """A joint slides as another turns: the sliding of the second is the radius times the turning of the first, from the
    placements on."""

    type: Literal["rack"]
    dimensions = (2, 3)
    joints: TwoNames = Field(description="name of a joint that turns, and of one that slides")
    radius: Annotated[NotZeroOrParameter, Unit("m")] = Field(
        description="way for each rad (m); negative where it slides back as the first turns on"
    )

    def shares(self, motion):
        """Return ``s_2 - radius s_1``."""
        first, second = self.joints
        return [Share(second, "sliding", "joints"), Share(first, "turning", "joints", self.radius, -1.0)]


class Screw(CouplingEntry):
    """A joint slides along its axis as it turns about it: a lead for each turn, from the placements on."""

    type: Literal["screw"]
    dimensions = (3,)
    joint: Name = Field(description="name of a joint that turns and slides: a cylindrical one")
    lead: Annotated[NotZeroOrParameter, Unit("m")] = Field(
        description="way for each turn (m); negative where the thread is left-handed"
    )

    def shares(self, motion):
        """Return ``s_sliding - lead / (2 pi) s_turning``."""
        turning = Share(self.joint, "turning", "joint", self.lead, -1.0 / (2.0 * math.pi))
        return [Share(self.joint, "sliding", "joint"), turning]


class SumOfMotions(CouplingEntry):
    """A sum of the motions of joints keeps the value that it has as the bodies are placed."""

    type: Literal["coupling"]
    dimensions = (2, 3)
    terms: Annotated[dict[Name, NotZeroOrParameter], Unit()] = Field(
        min_length=2,
        description="factor of the motion (rad or m) of each joint, numbers or parameters' names, by the joints' names",
    )

    def shares(self, motion):
        return [Share(joint, motion(joint, None), "terms", factor) for joint, factor in self.terms.items()]

    def measured(self, scene, entry):
        """Yield the factors, of a sum that is in the unit of the first joint's motion."""
        yield from super().measured(scene, entry)
        first, *_ = shares = self.shares_in(scene)
        for share in shares:
            above, below = ("m" if one.motion == "sliding" else "1" for one in (first, share))
            unit = "1" if above == below else f"1/{below}" if above == "1" else above
            yield Use(f"{entry}.terms.{share.joint}", share.factor, "any", (unit,))


class Cam(CouplingEntry):
    """A joint follows a cam: its motion is a cubic spline, of the turning of another, that repeats with every turn."""

    type: Literal["cam"]
    dimensions = (2, 3)
    from_placements = False
    joints: TwoNames = Field(description="name of the joint that turns with the cam, and of the follower's")
    motion: Literal["turning", "sliding"] | None = Field(
        None, description="which motion of the follower's joint; needed where it has both"
    )
    table: Annotated[
        tuple[Pair, ...], Field(min_length=FEWEST_POINTS), AfterValidator(_closed), Unit(), OrFile(True)
    ] = Field(
        description="points (angle of the first, rad; follower's motion, m or rad) over one turn, of which the last is "
        "the first again"
    )

    def shares(self, motion):
        """Return ``s_2 - f(s_1)``."""
        first, second = self.joints
        follower = motion(second, self.motion)
        return [Share(second, follower, "joints"), Share(first, "turning", "joints", -1.0, table=self.table)]

    def measured(self, scene, entry):
        """Yield the angles, and the follower's motion."""
        yield from super().measured(scene, entry)
        units = "rad", "m" if self.shares_in(scene)[0].motion == "sliding" else "rad"
        yield from Use.of_rows(f"{entry}.table", self.table, *units)

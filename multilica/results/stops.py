# SPDX-License-Identifier: Apache-2.0
"""Stops of a drive, and the registrations that link them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

from pydantic import Field

from multilica.geometry import FloatArray, RigidTransform
from multilica.results.registrations import PairRegistration
from multilica.results.values import Figure


class DriveView(NamedTuple):
    """One LiDAR at one stop."""

    lidar: str
    stop: str

    @property
    def label(self) -> str:
        """Unique name of the view."""
        return f"{self.lidar} at {self.stop}"


@dataclass(frozen=True, slots=True, eq=False)
class ViewPair:
    """A registration of two views of a drive.

    Args:
        registration: its target and source are LiDARs, the same one for a LiDAR that is registered with itself.
        target_stop, source_stop: the same stop for a pair within it.
        is_unique: with the same attitude, it fits at no other place nearly as well.
    """

    registration: PairRegistration
    target_stop: str
    source_stop: str
    is_unique: bool = False

    @property
    def target(self) -> DriveView:
        """The view that is the target."""
        return DriveView(self.registration.target, self.target_stop)

    @property
    def source(self) -> DriveView:
        """The view that is the source."""
        return DriveView(self.registration.source, self.source_stop)

    @property
    def views(self) -> frozenset[DriveView]:
        """Both views, without order."""
        return frozenset((self.target, self.source))

    @property
    def stops(self) -> frozenset[str]:
        """Both stops, without order."""
        return frozenset((self.target_stop, self.source_stop))

    @property
    def counts(self) -> bool:
        """True if the registration is accepted or uncertain, with its information."""
        found = self.registration
        return found.information is not None and found.verdict.counts

    @property
    def is_link(self) -> bool:
        """True if it links two stops."""
        return self.target_stop != self.source_stop


@dataclass(frozen=True, slots=True, eq=False)
class LinkedStops:
    """Links between stops with the poses of the vehicle that follow.

    Args:
        links: between these stops.
        poses: per stop the root LiDAR in its own frame at the first of the stops that are linked with this one.
        first: the first stop of each group of linked ones, whose pose is the identity.
    """

    links: Sequence[ViewPair] = ()
    poses: Mapping[str, RigidTransform] = field(default_factory=dict)
    first: frozenset[str] = frozenset()

    def groups(self) -> list[list[str]]:
        """Return the stops that links connect, the first one of each group first, else in name order."""
        groups = {name: {name} for name in self.poses}
        for link in self.links:
            joined = set.union(*(groups[name] for name in link.stops))
            groups.update(dict.fromkeys(joined, joined))
        of_first = [groups[name] for name in sorted(self.first) if name in groups]
        return [sorted(group, key=lambda name: (name not in self.first, name)) for group in of_first]


@dataclass(frozen=True, slots=True)
class StopLink:
    """A registration that links two stops."""

    target: Annotated[str, Field(description="LiDAR that is the target.")]
    target_stop: Annotated[str, Field(description="Its stop.")]
    source: Annotated[str, Field(description="LiDAR that is the source, perhaps the same one.")]
    source_stop: Annotated[str, Field(description="Its stop.")]
    evidence: Annotated[Figure, Field(description="Log-odds that its pose is the true one.")]
    used: Annotated[bool, Field(description="True if others confirm it, so that the poses rest on it.")]
    reason: Annotated[str, Field(description="Reason why it is not used; empty if it is.")] = ""
    after_m: Annotated[Figure | None, Field(description="Distance of the poses from it; null if it is not used.")] = (
        None
    )
    after_deg: Annotated[Figure | None, Field(description="Angle of the poses from it; null if not used.")] = None
    probability: Annotated[
        Figure | None,
        Field(description="Probability that a correct link disagrees as much or more, by its covariance; or null."),
    ] = None

    @property
    def stops(self) -> frozenset[str]:
        """Both stops, without order."""
        return frozenset((self.target_stop, self.source_stop))


@dataclass(frozen=True, slots=True)
class Knock:
    """A LiDAR that moved on the vehicle between two stops."""

    lidar: Annotated[str, Field(description="Name of the LiDAR.")]
    before: Annotated[str, Field(description="The last stop that is surely before it moved.")]
    after: Annotated[str, Field(description="The first stop that is surely after it.")]
    distance_m: Annotated[float, Field(description="Distance by which it moved.")]
    angle_deg: Annotated[float, Field(description="Angle by which it turned.")]
    left_out: Annotated[
        tuple[str, ...], Field(description="Stops on one side of it, and between, that do not count for its pose.")
    ]
    rivals: Annotated[
        tuple[str, ...], Field(description="Other LiDARs, whose motion explains it as well: with two LiDARs, both do.")
    ] = ()

    @property
    def is_undone(self) -> bool:
        """True if the pose of the LiDAR is the one before it moved, where it is no longer."""
        return self.after in self.left_out

    @property
    def motion(self) -> str:
        """The motion for people."""
        size = f"{1e3 * self.distance_m:.0f} mm, {self.angle_deg:.2f} deg"
        return f"{' or '.join((self.lidar, *self.rivals))} moved by {size} between {self.before} and {self.after}"

    @property
    def text(self) -> str:
        """The knock for people."""
        return f"{self.motion}; the pose of {self.lidar} is the one without {', '.join(self.left_out)}"


@dataclass(frozen=True, slots=True)
class StopMotion:
    """The motion of a LiDAR between two stops, by odometry."""

    lidar: Annotated[str, Field(description="Name of the LiDAR.")]
    before: Annotated[str, Field(description="The earlier stop.")]
    after: Annotated[str, Field(description="The next stop.")]
    distance_m: Annotated[float, Field(description="Distance between the positions of the LiDAR at both stops.")]
    angle_deg: Annotated[float, Field(description="Angle by which it turned.")]
    sigma_m: Annotated[float, Field(description="Standard deviation along the direction that is known worst.")]
    sigma_deg: Annotated[float, Field(description="Standard deviation about the axis that is known worst.")]
    used: Annotated[bool, Field(description="False if it contradicts the other motions.")]

    @property
    def stops(self) -> frozenset[str]:
        """Both stops, without order."""
        return frozenset((self.before, self.after))


@dataclass(frozen=True, slots=True, eq=False)
class StopPose:
    """The vehicle at one stop of a drive.

    Args:
        first: the first of the stops that links connect with this one; this one itself if none do.
        T_first_stop: the target LiDAR at this stop in its own frame at the first stop.
        covariance: (6, 6) rotation (rad), translation (m) along the axes of the first stop; None at the first stop.
    """

    name: str
    first: str
    T_first_stop: RigidTransform
    covariance: FloatArray | None = None

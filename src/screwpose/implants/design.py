"""What a parametric screw measures: the dimensions, what they allow, and the lengths that follow from them."""

import math
from dataclasses import dataclass, fields

from screwpose.errors import MeshError

MAX_TILT_DEG = 25.0  # the tulip's opening is made for it; polyaxial screws on the market allow 20 to 30
_WALL_MM = 0.4  # thinner metal than this nobody makes


@dataclass(frozen=True)
class ScrewDesign:
    """The dimensions of a pedicle screw, in mm and degrees; the defaults are a common 6.5 x 45 with a tower.

    Parameters
    ----------
    shank_diameter_mm, shank_length_mm : over the thread; from the tip to the base of the tulip.
    core_diameter_mm : at the root of the thread; None for 72 % of the diameter.
    pitch_mm, thread_starts : from one turn to the next, and how many threads run side by side.
    cannulation_mm : diameter of the bore along the axis for a guide wire; 0 for none.
    tulip_diameter_mm, tulip_height_mm : of the head.
    rod_diameter_mm : the rod channel is a little wider, and runs along z.
    tower : whether an extension tower stands on the tulip.
    tower_outer_mm, tower_inner_mm, tower_length_mm : its diameters, and its length above the tulip.
    slot_lengths_mm : of the slots above the tulip on the +z and the -z side. Different lengths make the roll unique.
    notch_width_mm, notch_depth_mm : of the notch in the upper rim on the +x side, which shows the roll from the other
        side; depth 0 for none.
    polyaxial : whether the head turns on a ball.
    tilt_deg, tilt_direction_deg : how far a polyaxial head leans, and whither: 0 towards +x, 90 towards +z.
    segments : corners of a full circle, a multiple of four.

    Raises
    ------
    MeshError
        A dimension that is out of range or does not go with the others; names the field.
    """

    shank_diameter_mm: float = 6.5
    shank_length_mm: float = 45.0
    core_diameter_mm: float | None = None
    pitch_mm: float = 2.75
    thread_starts: int = 1
    cannulation_mm: float = 1.6
    tulip_diameter_mm: float = 13.0
    tulip_height_mm: float = 16.0
    rod_diameter_mm: float = 5.5
    tower: bool = True
    tower_outer_mm: float = 12.0
    tower_inner_mm: float = 10.0
    tower_length_mm: float = 100.0
    slot_lengths_mm: tuple[float, float] = (60.0, 42.0)
    notch_width_mm: float = 4.0
    notch_depth_mm: float = 9.0
    polyaxial: bool = False
    tilt_deg: float = 0.0
    tilt_direction_deg: float = 0.0
    segments: int = 48

    def __post_init__(self) -> None:
        for field in fields(self):
            values = getattr(self, field.name)
            for value in values if isinstance(values, tuple) else (values,):
                if value is not None and not math.isfinite(value):
                    raise MeshError(f"{value} is no dimension", field=field.name, expected="a finite number")
        self._check_shank()
        self._check_head()
        if self.tower:
            self._check_tower()

    @property
    def core_mm(self) -> float:
        """Diameter at the root of the thread."""
        return 0.72 * self.shank_diameter_mm if self.core_diameter_mm is None else self.core_diameter_mm

    @property
    def channel_mm(self) -> float:
        """Width of the rod channel and the slots: the rod and some play."""
        return self.rod_diameter_mm + 0.3

    @property
    def ball_radius_mm(self) -> float:
        """Radius of a polyaxial screw's ball: it must pass no smaller hole than the thread does."""
        return max(3.75, 0.5 * self.shank_diameter_mm + 0.75)

    @property
    def neck_radius_mm(self) -> float:
        """Radius where the shank meets the head: slim under a ball, so that it can tilt."""
        return 0.55 * self.ball_radius_mm if self.polyaxial else 0.5 * self.core_mm

    @property
    def opening_rad(self) -> float:
        """Half the angle of the cone below the ball in which the neck moves."""
        return math.asin(self.neck_radius_mm / self.ball_radius_mm) + math.radians(MAX_TILT_DEG + 2.0)

    @property
    def pivot_height_mm(self) -> float:
        """Height of the ball's centre above the tip."""
        return self.shank_length_mm + self.ball_radius_mm * math.cos(self.opening_rad) + 0.3

    @property
    def thread_end_mm(self) -> float:
        """Height above the tip at which the thread ends and the neck begins."""
        if not self.polyaxial:
            return self.shank_length_mm - 1.2
        free = self.opening_rad - math.radians(MAX_TILT_DEG)  # the thread stays in the cone at the largest tilt
        return self.pivot_height_mm - 0.5 * self.shank_diameter_mm / math.tan(free)

    @property
    def channel_bottom_mm(self) -> float:
        """Height above the tip of the lowest line of the rod channel."""
        if self.polyaxial:
            return self.pivot_height_mm + self.ball_radius_mm + 0.4
        return self.shank_length_mm + 0.32 * self.tulip_height_mm

    @property
    def tulip_top_mm(self) -> float:
        """Height of the tulip's rim above the tip."""
        return self.shank_length_mm + self.tulip_height_mm

    def _check_shank(self) -> None:
        _within("shank_diameter_mm", self.shank_diameter_mm, 3.0, 12.0)
        _within("shank_length_mm", self.shank_length_mm, max(15.0, 3.0 * self.shank_diameter_mm), 150.0)
        _within("core_diameter_mm", self.core_mm, 0.5 * self.shank_diameter_mm, 0.95 * self.shank_diameter_mm)
        _within("pitch_mm", self.pitch_mm, 0.8, 6.0)
        _within("thread_starts", self.thread_starts, 1, 3)
        _within("cannulation_mm", self.cannulation_mm, 0.0, 2.0 * (0.3 * self.core_mm + 0.3 - _WALL_MM))
        if self.segments % 4 or not 16 <= self.segments <= 256:
            raise MeshError(f"{self.segments} segments", field="segments", expected="a multiple of 4 from 16 to 256")

    def _check_head(self) -> None:
        _within("rod_diameter_mm", self.rod_diameter_mm, 3.0, 8.0)
        ball_mm = 2.0 * self.ball_radius_mm if self.polyaxial else self.shank_diameter_mm
        _within("tulip_diameter_mm", self.tulip_diameter_mm, max(ball_mm + 3.0, self.channel_mm + 5.0), 25.0)
        lowest = self.channel_bottom_mm - self.shank_length_mm + self.rod_diameter_mm + 1.0
        _within("tulip_height_mm", self.tulip_height_mm, lowest, 40.0)
        if self.tilt_deg and not self.polyaxial:
            raise MeshError(
                f"a tilt of {self.tilt_deg:g} degrees for a monoaxial screw",
                field="tilt_deg",
                remedy="Set polyaxial, or leave the tilt at 0.",
            )
        _within("tilt_deg", self.tilt_deg, 0.0, MAX_TILT_DEG)

    def _check_tower(self) -> None:
        # The wall must meet the tulip's arms, or the tower would hang in the air.
        inner_low, inner_high = self.channel_mm + 1.0, self.tulip_diameter_mm - 1.0
        _within("tower_inner_mm", self.tower_inner_mm, inner_low, inner_high)
        _within("tower_outer_mm", self.tower_outer_mm, self.tower_inner_mm + 2.0 * _WALL_MM, 30.0)
        _within("tower_length_mm", self.tower_length_mm, 10.0, 250.0)
        longest = self.tower_length_mm - self.notch_depth_mm - 2.0
        for length in self.slot_lengths_mm:
            _within("slot_lengths_mm", length, self.channel_mm, longest)
        _within("notch_depth_mm", self.notch_depth_mm, 0.0, 0.5 * self.tower_length_mm)
        _within("notch_width_mm", self.notch_width_mm, 0.5, self.tower_inner_mm)


def _within(field: str, value: float, low: float, high: float) -> None:
    if not low - 1e-9 <= value <= high + 1e-9:
        raise MeshError(
            f"{value:g} does not go with the other dimensions", field=field, expected=f"{low:.4g} to {high:.4g}"
        )

"""Draws a state: the scene in perspective, the cone's footprint from above, strip charts, actuators and a header.

Imported only when something is to be rendered, since it needs pygame (extra ``render``). A `Renderer` draws on a
surface in memory and needs no display; a `Window` shows such surfaces.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
with warnings.catch_warnings():
    # It looks for setuptools' old pkg_resources, which warns where it still exists.
    warnings.simplefilter("ignore")
    import pygame
    import pygame.gfxdraw

from uwoc_gym.scenario import Scenario
from uwoc_gym.spaces import FRAME, SMALLEST_DETAILED, check_render_size
from uwoc_gym.world.sea.pulses import DrawnPulse, drawn_pulses

Array = npt.NDArray[np.float64]
Frame = npt.NDArray[np.uint8]
Colour = tuple[int, int, int]
State = Mapping[str, Any]

WINDOW_S = 30.0
"""Time that charts and trails reach back [s]."""

# Okabe and Ito's colours on dark blue; whatever a colour says is also said by a shape or a word.
YELLOW, ORANGE, SKY, GREEN, RED = (240, 228, 66), (230, 159, 0), (86, 180, 233), (0, 190, 140), (235, 110, 40)
ACCENT: Colour = ORANGE
"""Colour of the AUV where nobody asks for another."""
CONE_LIT, CONE_DARK = (246, 226, 96), (92, 88, 52)
"""The cone's footprint in a plain picture: with the AUV inside, and outside."""
_GROUND, _PANEL, _EDGE, _GRID = (10, 24, 40), (16, 35, 56), (52, 80, 108), (34, 58, 84)
_TEXT, _DIM, _WHITE = (236, 242, 248), (160, 182, 204), (255, 255, 255)
_DEEP, _SHALLOW, _SURFACE = (6, 26, 48), (24, 84, 118), (150, 205, 235)
# Cividis, which is even in lightness to any eye.
_MAP = np.array([(0, 34, 78), (53, 69, 108), (102, 105, 112), (148, 142, 119), (200, 184, 102), (254, 232, 56)], float)
_DARK = (14, 20, 32)

_COLUMNS = ("time", "x", "y", "ship_x", "ship_y", "rate", "range", "pointing", "inside")
_T, _X, _Y, _SHIP_X, _SHIP_Y, _RATE, _RANGE, _POINTING, _INSIDE = range(len(_COLUMNS))
_AZIMUTH, _ELEVATION = math.radians(28.0), math.radians(24.0)


class NoDisplayError(RuntimeError):
    """There is no display to open a window on."""


class _Layout(NamedTuple):
    """Where things are in a frame of so many units; the scene takes what is left over."""

    upright: bool
    width: float
    header: float
    scene: tuple[float, float, float, float]
    above: tuple[float, float, float, float]
    bars: tuple[float, float, float, float]
    charts: tuple[float, float, float, float]


def _layout(size: tuple[int, int]) -> tuple[_Layout, float]:
    """Places of a frame's parts, and pixels per unit; a frame below 4 to 3 gets the upright arrangement."""
    upright = size[0] * 3 < size[1] * 4
    unit = min(size[0] / (640 if upright else 1280), size[1] / 720)
    w, h = size[0] / unit, size[1] / unit
    if upright:
        y = h - 354
        return _Layout(
            True, w, 88, (0, 88, w, y - 96), (8, y, 218, 218), (8, y + 226, 218, 120), (234, y, w - 242, 346)
        ), unit
    x = w - 496
    return _Layout(
        False, w, 52, (0, 52, x - 8, h - 52), (x, 60, 304, 304), (x + 312, 60, 176, 304), (x, 372, 488, h - 380)
    ), unit


class Renderer:
    """Draws one simulation on a surface in memory.

    Args:
        scenario: The scenario flown.
        size: Width and height [px]; an upright one, below 4 to 3, is arranged differently. Below 320 × 180 the
            picture is a plain one for pixel agents: cone, ship and AUV from above, north up, the ship in the middle.
        title: What the header says first.
        accent: Colour of the AUV and its trail.

    Raises:
        ValueError: ``size`` isn't allowed.
    """

    def __init__(
        self, scenario: Scenario, size: Sequence[int] = FRAME, title: str = "", accent: Colour = ACCENT
    ) -> None:
        self.size = check_render_size(size)
        self.title = title
        self.accent = accent
        self._plain = any(side < least for side, least in zip(self.size, SMALLEST_DETAILED, strict=True))
        self._layout, self._unit = _layout(self.size)
        pygame.font.init()
        self.surface = pygame.Surface(self.size, 0, 32)
        self._texts: dict[tuple[str, int, Colour], pygame.Surface] = {}
        self._kept: dict[Any, pygame.Surface] = {}
        self._rows = np.zeros((256, len(_COLUMNS)))
        self.samples = 0
        self._state: State = {}
        self.configure(scenario)

    def configure(self, scenario: Scenario) -> None:
        """Change the scenario; takes effect with the next `begin`."""
        self.scenario = scenario
        self._limits = scenario.vehicle.force_limits

    def begin(self, state: State, parameters: Mapping[str, float]) -> None:
        """Forget what was and begin with a state, as `TrackingEnv.state` and `TrackingEnv.parameters` give them."""
        self.samples = 0
        self.delivered_bit = 0.0
        self._since = float(state["time_s"])
        drawn = {path.removeprefix("link."): value for path, value in parameters.items() if path.startswith("link.")}
        self._link = self.scenario.link.merged(drawn)
        self._depth = float(state["depth_m"])
        self._slant = float(state["slant_height_m"])
        self._fov = self._link.value("field_of_view_rad")
        self._radius = self._link.cone().footprint_radius_m(self._depth) or 0.0
        self._threshold = math.log10(self._link.threshold_bit_rate_bps)
        self._best = math.log10(max(float(self._link.bit_rate(self._depth, 0.0)), 10.0 ** (self._threshold + 0.1)))
        self._pulses = drawn_pulses(parameters)
        self._notes: list[DrawnPulse] = []
        self._kept.clear()
        self._texts.clear()
        self._camera: Array | None = None
        self.record(state)

    def record(self, state: State) -> None:
        """Take a later state of the same episode into trail, charts and data delivered."""
        if self.samples == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        time, rate, inside = float(state["time_s"]), float(state["bit_rate_bps"]), bool(state["in_cone"])
        elapsed = time - self._rows[self.samples - 1, _T] if self.samples else 0.0
        pose, ship = state["pose"], state["ship_pose"]
        self._rows[self.samples] = (
            time, pose[0], pose[1], ship[0], ship[1],
            math.log10(rate) if rate > 0.0 else math.nan,
            state["range_m"], math.degrees(state["pointing_error_rad"]), inside,
        )  # fmt: skip
        self.samples += 1
        self.delivered_bit += rate * elapsed if inside else 0.0
        self._state = state
        self._follow(elapsed)

    def note(self, text: str, duration_s: float = 1.0) -> None:
        """Show a few words in the scene for so long from now [s]."""
        now = float(self._state["time_s"])
        self._notes.append(DrawnPulse(now, now + duration_s, text))

    def frame(self) -> Frame:
        """The picture of the last state recorded, shape (height, width, 3)."""
        self.draw()
        data = pygame.image.tobytes(self.surface, "RGB")
        return np.frombuffer(data, dtype=np.uint8).reshape(self.size[1], self.size[0], 3).copy()

    def draw(self) -> pygame.Surface:
        """The picture of the last state recorded, on a surface that the next call draws over."""
        if self._plain:
            self._draw_plain()
            return self.surface
        self.surface.fill(_GROUND)
        self._draw_scene(self._rect(self._layout.scene))
        self._draw_header()
        self._draw_above(self._rect(self._layout.above))
        self._draw_bars(self._rect(self._layout.bars))
        self._draw_charts(self._rect(self._layout.charts))
        return self.surface

    # The plain picture.

    def _draw_plain(self) -> None:
        """Few colours without shades between them; what is further off than the picture reaches is at its edge."""
        surface, width, height = self.surface, *self.size
        surface.fill(_DEEP)
        reach = max(4.0 * self._radius, 2.0 * self._depth, 4.0)
        metre = min(width, height) / (2.0 * reach)
        middle = np.array([0.5 * width, 0.5 * height])
        pose, ship = self._state["pose"], self._state["ship_pose"]
        if self._radius > 0.0:
            colour = CONE_LIT if self._state["in_cone"] else CONE_DARK
            pygame.draw.circle(surface, colour, middle.tolist(), max(1, round(self._radius * metre)))

        def turned(outline: Array, yaw: float, at: Array) -> list[list[float]]:
            ahead, aside = (metre * column for column in outline.T)
            x, y = ahead * math.cos(yaw) - aside * math.sin(yaw), ahead * math.sin(yaw) + aside * math.cos(yaw)
            return (at + np.stack([y, -x], axis=-1)).tolist()  # type: ignore[no-any-return]

        hull = turned(_SHIP_HULL, ship[2], middle)
        apart = metre * np.array([pose[1] - ship[1], ship[0] - pose[0]])
        edge = middle - 0.06 * min(width, height)
        at = middle + apart * min(1.0, *(edge / np.maximum(np.abs(apart), 1e-9)))
        # An arrow that even the smallest picture shows.
        arrow = max(1.3, 2.5 / metre) * np.array([[1.0, 0.0], [-0.8, 0.6], [-0.4, 0.0], [-0.8, -0.6]])
        pygame.draw.polygon(surface, self.accent, turned(arrow, pose[2], at))
        pygame.draw.polygon(surface, _WHITE, hull, 1)

    # Text and rectangles.

    def _px(self, units: float) -> int:
        return max(1, round(units * self._unit))

    def _rect(self, units: Sequence[float]) -> pygame.Rect:
        x, y, width, height = (round(value * self._unit) for value in units)
        return pygame.Rect(x, y, width, height)

    def _text(self, text: str, size: int, colour: Colour = _TEXT) -> pygame.Surface:
        key = (text, size, colour)
        if key not in self._texts:
            if len(self._texts) > 600:
                self._texts.clear()
            self._texts[key] = text_image(text, self._px(size), colour)
        return self._texts[key]

    def _write(
        self, text: str, size: int, at: tuple[float, float], colour: Colour = _TEXT, align: str = "topleft"
    ) -> pygame.Rect:
        image = self._text(text, size, colour)
        place = image.get_rect(**{align: (round(at[0]), round(at[1]))})
        self.surface.blit(image, place)
        return place

    def _box(self, rect: pygame.Rect) -> None:
        pygame.draw.rect(self.surface, _PANEL, rect, border_radius=self._px(5))
        pygame.draw.rect(self.surface, _EDGE, rect, 1, border_radius=self._px(5))

    # The header.

    def _draw_header(self) -> None:
        upright = self._layout.upright
        whole = self._rect((0, 0, self._layout.width, self._layout.header))
        pygame.draw.rect(self.surface, _PANEL, whole)
        pygame.draw.line(self.surface, _EDGE, whole.bottomleft, whole.bottomright)
        line = self._px(24 if upright else 26)
        gap = self._px(16)
        y = whole.top + line
        width = self._px(8)
        pygame.draw.rect(self.surface, self.accent, (whole.left, whole.top, width, whole.height))
        self._write(self.title, 32, (whole.left + width + gap, y), align="midleft")
        inside = bool(self._state["in_cone"])
        if not upright:
            right = whole.right - gap
            right = self._write(self.delivered(), 30, (right, y), align="midright").left - 2 * gap
            right = self._lamp(right, y, inside) - 2 * gap
            self._write(f"t = {self._state['time_s']:6.2f} s", 30, (right, y), align="midright")
            return
        self._write(f"t = {self._state['time_s']:6.2f} s", 30, (whole.right - gap, y), align="midright")
        y = whole.top + self._px(64)
        self._lamp(whole.left + width + gap + self._px(128), y, inside)
        self._write(self.delivered(), 30, (whole.right - gap, y), align="midright")

    def delivered(self) -> str:
        """The data delivered since the pictures began, in words."""
        since = f" since {self._since:.1f} s" if self._since > 0.0 else ""
        return f"{self.delivered_bit * 1e-9:.1f} Gbit delivered{since}"

    def _lamp(self, right: int, y: int, inside: bool) -> int:
        """A full green disc, or a ring with a cross; returns its left end."""
        words = self._write("IN LINK" if inside else "NO LINK", 30, (right, y), GREEN if inside else RED, "midright")
        radius = self._px(11)
        centre = (words.left - radius - self._px(8), y)
        if inside:
            pygame.draw.circle(self.surface, GREEN, centre, radius)
            pygame.draw.circle(self.surface, _WHITE, centre, radius, self._px(2))
        else:
            pygame.draw.circle(self.surface, RED, centre, radius, self._px(3))
            arm = round(radius * 0.55)
            for sense in (-1, 1):
                ends = (centre[0] - arm, centre[1] - sense * arm), (centre[0] + arm, centre[1] + sense * arm)
                pygame.draw.line(self.surface, RED, *ends, self._px(3))
        return centre[0] - radius

    # The scene in perspective: x to the north, y to the east, z down, seen from above the water.

    def _follow(self, elapsed: float) -> None:
        """Move the camera's target and distance softly to where ship and AUV are."""
        pose, ship = self._state["pose"], self._state["ship_pose"]
        apart = math.hypot(ship[0] - pose[0], ship[1] - pose[1])
        wanted = np.array([0.6 * ship[0] + 0.4 * pose[0], 0.6 * ship[1] + 0.4 * pose[1], 12.0 + 1.3 * apart])
        if self._camera is None:
            self._camera = wanted
        else:
            self._camera = self._camera + (wanted - self._camera) * (1.0 - math.exp(-elapsed / 0.8))

    def _project(self, points: npt.ArrayLike, rect: pygame.Rect) -> Array:
        """Places on the surface [px] of points (N, 3) [m] in the earth frame."""
        assert self._camera is not None
        x, y, distance = self._camera
        sa, ca, se, ce = math.sin(_AZIMUTH), math.cos(_AZIMUTH), math.sin(_ELEVATION), math.cos(_ELEVATION)
        axes = np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]])
        seen = (np.asarray(points, dtype=float) - (x, y, 0.5 * self._depth)) @ axes.T
        away = np.maximum(seen[:, 2] + distance, 0.3)
        focus = 1.15 * min(rect.width, 1.35 * rect.height)
        result: Array = seen[:, :2] * (focus / away)[:, None] + (rect.centerx, rect.top + 0.54 * rect.height)
        return result

    def _draw_scene(self, rect: pygame.Rect) -> None:
        surface = self.surface
        surface.set_clip(rect)
        surface.blit(self._keep(("water", rect.size), lambda: _gradient(rect.size)), rect)
        assert self._camera is not None
        pose, ship = self._state["pose"], self._state["ship_pose"]
        inside, depth = bool(self._state["in_cone"]), self._depth
        rows = self.recent()
        half = 0.42 * self._camera[2] + 2.0
        self._draw_plane(rect, depth, half, (38, 96, 128))
        apex = np.array([[ship[0], ship[1], 0.0]])
        turn = np.linspace(0.0, 2.0 * np.pi, 41)[:-1]
        if self._radius > 0.0:
            rim = np.stack([ship[0] + self._radius * np.cos(turn), ship[1] + self._radius * np.sin(turn)], axis=-1)
            rim = self._project(np.column_stack([rim, np.full(turn.size, depth)]), rect)
            tip = self._project(apex, rect)
            hull = _hull(np.concatenate([rim, tip]))
            self._fill(rim, (*YELLOW, 54))
            self._fill(hull, (*YELLOW, 58 if inside else 34))
            pygame.draw.aalines(surface, YELLOW, True, rim.tolist())
            pygame.draw.aalines(surface, (200, 190, 80), True, hull.tolist())
        self._trail(rect, rows[:, (_X, _Y)], depth, self.accent, 3)
        auv = self._project([[pose[0], pose[1], depth]], rect)[0]
        top = self._project(apex, rect)[0]
        if inside:
            strength = np.clip((rows[-1, _RATE] - self._threshold) / (self._best - self._threshold), 0.0, 1.0)
            pygame.draw.line(surface, _blend((120, 130, 70), (255, 250, 150), strength), auv, top, self._px(4))
            pygame.draw.aaline(surface, _WHITE, auv, top)
        else:
            _dashed(surface, RED, auv, top, self._px(7), self._px(2))
        self._draw_auv(rect, pose)
        self._draw_plane(rect, 0.0, half, (96, 160, 196), fill=(*_SURFACE, 26))
        self._trail(rect, rows[:, (_SHIP_X, _SHIP_Y)], 0.0, _WHITE, 2)
        self._draw_ship(rect, ship)
        mast = self._project([[ship[0], ship[1], -1.0]], rect)[0]
        name = self._label("ship", mast, -self._px(13))
        self._label("AUV", auv, self._px(26))
        self._draw_notes(rect, name)
        self._write(
            f"AUV {depth:.1f} m below the surface",
            22,
            (rect.left + self._px(12), rect.bottom - self._px(10)),
            _DIM,
            "bottomleft",
        )
        surface.set_clip(None)

    def _label(self, text: str, at: Array, offset: int) -> pygame.Rect:
        place = (at[0], at[1] + offset)
        shadow = self._text(text, 22, (0, 0, 0))
        self.surface.blit(shadow, shadow.get_rect(center=(round(place[0]) + 1, round(place[1]) + 1)))
        return self._write(text, 22, place, _WHITE, "center")

    def _draw_notes(self, rect: pygame.Rect, name: pygame.Rect) -> None:
        """What happens now, in the upper left corner, or in the right one where the ship's name is in the left."""
        now = float(self._state["time_s"])
        pad = self._px(12)
        y = rect.top + pad
        for begin, end, text in [*self._pulses, *self._notes]:
            if begin <= now < end + 0.5:
                image = self._text(text, 23, _WHITE)
                box = image.get_rect().inflate(self._px(20), self._px(12))
                box.topleft = (rect.left + pad, y)
                if box.colliderect(name):
                    box.right = rect.right - pad
                pygame.draw.rect(self.surface, (120, 40, 20), box, border_radius=self._px(6))
                pygame.draw.rect(self.surface, RED, box, self._px(2), border_radius=self._px(6))
                self.surface.blit(image, image.get_rect(center=box.center))
                y = box.bottom + self._px(6)

    def _fill(self, points: Array, colour: tuple[int, int, int, int]) -> None:
        pygame.gfxdraw.filled_polygon(self.surface, points.tolist(), colour)

    def _draw_plane(
        self, rect: pygame.Rect, z: float, half: float, colour: Colour, fill: tuple[int, int, int, int] | None = None
    ) -> None:
        """A square of the plane at depth ``z`` around the camera's target, with lines every 2 m or so."""
        assert self._camera is not None
        x, y = self._camera[:2]
        corners = [[x - half, y - half, z], [x - half, y + half, z], [x + half, y + half, z], [x + half, y - half, z]]
        outline = self._project(corners, rect)
        if fill is not None:
            self._fill(outline, fill)
        step = 2.0 if half < 14.0 else 4.0
        xs = np.arange(math.ceil((x - half) / step), math.floor((x + half) / step) + 1) * step
        ys = np.arange(math.ceil((y - half) / step), math.floor((y + half) / step) + 1) * step
        ends = [[[at, y - half, z], [at, y + half, z]] for at in xs] + [
            [[x - half, at, z], [x + half, at, z]] for at in ys
        ]
        faint = _blend(colour, _SHALLOW, 0.55)
        for start, end in self._project(np.array(ends).reshape(-1, 3), rect).reshape(-1, 2, 2).tolist():
            pygame.draw.aaline(self.surface, faint, start, end)
        pygame.draw.aalines(self.surface, colour, True, outline.tolist())

    def _trail(self, rect: pygame.Rect, points: Array, z: float, colour: Colour, width: int) -> None:
        """A line that fades with age."""
        stride = max(1, len(points) // 150)
        # Counted from the beginning, so that the same samples are drawn from frame to frame.
        offset = -(self.samples - len(points)) % stride
        chosen = np.concatenate([points[offset::stride], points[-1:]])
        seen = self._project(np.column_stack([chosen, np.full(len(chosen), z)]), rect)
        parts = 5
        for k in range(parts):
            part = seen[k * len(seen) // parts : (k + 1) * len(seen) // parts + 1]
            if len(part) > 1:
                shade = _blend(_SHALLOW, colour, (k + 1) / parts)
                pygame.draw.lines(self.surface, shade, False, part.tolist(), self._px(width))
                pygame.draw.aalines(self.surface, shade, False, part.tolist())

    def _solid(self, rect: pygame.Rect, outline: Array, pose: Any, z_low: float, z_high: float, shades: Any) -> None:
        """A body of upright sides above an outline (N, 2) in the body frame, drawn from far to near."""
        cosine, sine = math.cos(pose[2]), math.sin(pose[2])
        x = pose[0] + outline[:, 0] * cosine - outline[:, 1] * sine
        y = pose[1] + outline[:, 0] * sine + outline[:, 1] * cosine
        low = self._project(np.column_stack([x, y, np.full(len(x), z_low)]), rect)
        high = self._project(np.column_stack([x, y, np.full(len(x), z_high)]), rect)
        away = x * math.cos(_AZIMUTH) + y * math.sin(_AZIMUTH)
        following = np.roll(np.arange(len(x)), -1)
        sides = np.argsort(-(away + away[following]))
        for k in sides.tolist():
            n = following[k]
            side = np.array([low[k], low[n], high[n], high[k]])
            lit = 0.5 + 0.5 * math.sin(math.atan2(y[n] - y[k], x[n] - x[k]) - _AZIMUTH)
            pygame.draw.polygon(self.surface, _blend(shades[0], shades[1], lit), side.tolist())
        pygame.draw.polygon(self.surface, shades[2], high.tolist())
        pygame.draw.aalines(self.surface, _blend(shades[2], (0, 0, 0), 0.5), True, high.tolist())

    def _draw_auv(self, rect: pygame.Rect, pose: Any) -> None:
        accent = self.accent
        shades = (_blend(accent, (0, 0, 0), 0.65), _blend(accent, (0, 0, 0), 0.35), accent)
        depth = self._depth
        self._solid(rect, _AUV_BODY, pose, depth + 0.16, depth - 0.16, shades)
        self._solid(rect, _AUV_FIN, pose, depth - 0.16, depth - 0.42, shades)
        # The transmitter's dome looks up; the nose has a white band, so that the heading is seen from any side.
        ahead = np.array([math.cos(pose[2]), math.sin(pose[2])])
        aside = np.array([-ahead[1], ahead[0]])
        centre = np.asarray(pose[:2])
        band = [centre + 0.55 * ahead + 0.2 * aside, centre + 0.85 * ahead, centre + 0.55 * ahead - 0.2 * aside]
        seen = self._project([[*point, depth - 0.17] for point in band], rect)
        pygame.draw.polygon(self.surface, _WHITE, seen.tolist())
        dome = self._project([[*centre, depth - 0.2]], rect)[0]
        pygame.draw.circle(self.surface, (255, 250, 180), dome.tolist(), self._px(4))

    def _draw_ship(self, rect: pygame.Rect, pose: Any) -> None:
        self._solid(rect, _SHIP_HULL, pose, 0.05, -0.35, ((120, 40, 40), (190, 70, 60), (214, 200, 178)))
        self._solid(rect, _SHIP_CABIN, pose, -0.35, -0.8, ((170, 176, 184), (225, 230, 236), _WHITE))

    # The footprint from above: north up, the ship in the middle.

    def _draw_above(self, rect: pygame.Rect) -> None:
        title, foot = self._px(24), self._px(30)
        self._box(rect)
        pad = self._px(6)
        self._write("from above, lines every 2 m", 20, (rect.left + pad + 2, rect.top + self._px(7)), _DIM)
        side = min(rect.width - 2 * pad, rect.height - title - foot)
        square = pygame.Rect(0, 0, side, side)
        square.midtop = (rect.centerx, rect.top + title)
        reach = max(2.0 * self._radius, 1.0 * self._depth, 2.0)
        metre = side / (2.0 * reach)
        self.surface.blit(self._keep(("map", side), lambda: self._map(side, reach)), square)
        self.surface.set_clip(square)
        pose, ship = self._state["pose"], self._state["ship_pose"]

        def place(x: Any, y: Any) -> Array:
            return np.stack([square.centerx + metre * np.asarray(y), square.centery - metre * np.asarray(x)], axis=-1)

        for k in range(-int(reach // 2), int(reach // 2) + 1):
            for ends in (place([2 * k] * 2, [-reach, reach]), place([-reach, reach], [2 * k] * 2)):
                pygame.draw.line(self.surface, (44, 56, 76), *ends.tolist())
        ring = round(self._radius * metre)
        if ring > 0:
            pygame.draw.circle(self.surface, _WHITE, square.center, ring, self._px(2))
        bow = place(0.8 * np.cos(ship[2]), 0.8 * np.sin(ship[2]))
        pygame.draw.line(self.surface, _WHITE, square.center, bow.tolist(), self._px(2))
        pygame.draw.circle(self.surface, _WHITE, square.center, self._px(4))
        pygame.draw.circle(self.surface, (0, 0, 0), square.center, self._px(2))
        rows = self.recent(10.0)
        track = place(rows[:, _X] - rows[:, _SHIP_X], rows[:, _Y] - rows[:, _SHIP_Y])
        if len(track) > 1:
            pygame.draw.lines(self.surface, (0, 0, 0), False, track.tolist(), self._px(4))
            pygame.draw.lines(self.surface, self.accent, False, track.tolist(), self._px(2))
        dx, dy = pose[0] - ship[0], pose[1] - ship[1]
        away = max(abs(dx), abs(dy))
        if away > 0.95 * reach:
            # Off the map: a pointer at its edge and how far it is.
            edge = 0.88 * reach / away
            centre, heading, size = place(dx * edge, dy * edge), math.atan2(dy, dx), self._px(9)
            distance = f"AUV {math.hypot(dx, dy):.1f} m away"
            self._write(distance, 22, (square.centerx, square.bottom - self._px(4)), _WHITE, "midbottom")
        else:
            centre, heading, size = place(dx, dy), pose[2], self._px(11)
        corner = np.array([0.0, 2.5, math.pi, -2.5]) + heading
        length = size * np.array([1.3, 1.0, 0.35, 1.0])
        arrow = centre + np.stack([length * np.sin(corner), -length * np.cos(corner)], axis=-1)
        pygame.draw.polygon(self.surface, self.accent, arrow.tolist())
        pygame.draw.polygon(self.surface, (0, 0, 0), arrow.tolist(), self._px(2))
        self.surface.set_clip(None)
        # The scale of the map's colours.
        bar = pygame.Rect(square.left + self._px(52), square.bottom + self._px(9), side - self._px(108), self._px(12))
        self.surface.blit(self._keep(("scale", bar.size), lambda: _scale(bar.size)), bar)
        self._write(_rate_words(10.0**self._threshold), 18, (bar.left - self._px(5), bar.centery), _DIM, "midright")
        self._write(_rate_words(10.0**self._best), 18, (bar.right + self._px(5), bar.centery), _DIM, "midleft")

    def _map(self, side: int, reach: float) -> pygame.Surface:
        radius = np.linspace(0.0, 1.5 * reach, 1500)
        rates = np.asarray(self._link.bit_rate(np.hypot(radius, self._depth), np.arctan2(radius, self._depth)))
        level = (np.log10(np.maximum(rates, 1.0)) - self._threshold) / (self._best - self._threshold)
        # Above its rim the cone is lit; outside the field of view nothing is.
        profile = np.column_stack(
            [np.interp(np.clip(level, 0.0, 1.0), np.linspace(0, 1, len(_MAP)), c) for c in _MAP.T]
        )
        profile[(rates <= 0.0) | (level < 0.0)] = _DARK
        axis = (np.arange(side) - 0.5 * (side - 1)) * (2.0 * reach / side)
        index = (np.hypot(axis[:, None], axis) * (1499 / (1.5 * reach))).round().astype(int)
        return pygame.surfarray.make_surface(profile[np.minimum(index, 1499)].astype(np.uint8))

    # The actuators.

    def _draw_bars(self, rect: pygame.Rect) -> None:
        self._box(rect)
        pad = self._px(8)
        self._write("actuators", 20, (rect.left + pad, rect.top + self._px(7)), _DIM)
        top = rect.top + self._px(26)
        pitch = (rect.bottom - top - self._px(4)) / 3
        upright = pitch < self._px(50)
        force = self._state["force"]
        for k, (name, unit) in enumerate((("surge", "N"), ("sway", "N"), ("yaw", "N m"))):
            y = top + k * pitch
            words = f"{force[k]:+.0f} {unit}"
            if upright:
                bar = pygame.Rect(
                    rect.left + self._px(54), round(y + 0.2 * pitch), rect.width - self._px(150), round(0.5 * pitch)
                )
                self._write(name, 22, (rect.left + pad, bar.centery), align="midleft")
                self._write(words, 22, (rect.right - pad, bar.centery), align="midright")
            else:
                bar = pygame.Rect(rect.left + pad, round(y + 0.45 * pitch), rect.width - 2 * pad, round(0.3 * pitch))
                self._write(name, 24, (rect.left + pad, y + 0.22 * pitch), align="midleft")
                self._write(words, 24, (rect.right - pad, y + 0.22 * pitch), align="midright")
            pygame.draw.rect(self.surface, _GROUND, bar)
            share = float(np.clip(force[k] / self._limits[k], -1.0, 1.0)) if self._limits[k] > 0.0 else 0.0
            length = round(abs(share) * bar.width / 2)
            left = bar.centerx if share >= 0.0 else bar.centerx - length
            pygame.draw.rect(self.surface, RED if abs(share) >= 1.0 else SKY, (left, bar.top, length, bar.height))
            pygame.draw.line(self.surface, _TEXT, (bar.centerx, bar.top - 2), (bar.centerx, bar.bottom + 1))
            pygame.draw.rect(self.surface, _EDGE, bar, 1)

    # The strip charts.

    def recent(self, window_s: float = WINDOW_S) -> Array:
        """The samples of the last seconds, one a row, in which time comes first."""
        rows = self._rows[: self.samples]
        return rows[np.searchsorted(rows[:, _T], rows[-1, _T] - window_s) :]

    def _draw_charts(self, rect: pygame.Rect) -> None:
        rows = self.recent()
        stride = max(1, len(rows) // 400)
        rows = np.concatenate([rows[-(self.samples - len(rows)) % stride :: stride], rows[-1:]])
        angle = math.degrees(self._fov)
        farthest, widest = float(rows[:, _RANGE].max()), float(rows[:, _POINTING].max())
        low = self._threshold - 1.0
        charts = (
            ("log10 of bit rate in bit/s", _RATE, (low, math.ceil(self._best + 0.2)), self._threshold, "threshold", 2),
            ("range [m]", _RANGE, (0.0, _nice(max(farthest, 1.3 * self._slant))), self._slant, "slant height", 2),
            ("pointing error [°]", _POINTING, (0.0, 60.0 if widest < 58.0 else 90.0), angle, "field of view", 1),
        )
        gap = self._px(8)
        foot = self._px(20)
        height = (rect.height - 2 * gap - foot) / 3
        begin = max(self._since, rows[-1, _T] - WINDOW_S)
        for k, (name, column, span, limit, limit_name, digits) in enumerate(charts):
            box = pygame.Rect(rect.left, round(rect.top + k * (height + gap)), rect.width, round(height))
            self._draw_chart(box, rows, begin, name, column, span, limit, limit_name, digits)
        plot = self._plot(pygame.Rect(rect.left, 0, rect.width, 10))
        tick = math.ceil(begin / 5.0) * 5.0
        while tick <= begin + WINDOW_S:
            x = plot.left + (tick - begin) / WINDOW_S * plot.width
            if plot.left + self._px(8) < x < plot.right - self._px(84):
                self._write(f"{tick:.0f}", 19, (x, rect.bottom), _DIM, "midbottom")
            tick += 5.0
        self._write("time [s]", 19, (plot.right, rect.bottom), _DIM, "bottomright")

    def _plot(self, box: pygame.Rect) -> pygame.Rect:
        """The part of a chart's box in which its line is drawn."""
        left, top = self._px(38), self._px(24)
        return pygame.Rect(
            box.left + left, box.top + top, box.width - left - self._px(8), box.height - top - self._px(6)
        )

    def _draw_chart(
        self,
        box: pygame.Rect,
        rows: Array,
        begin: float,
        name: str,
        column: int,
        span: tuple[float, float],
        limit: float,
        limit_name: str,
        digits: int,
    ) -> None:
        plot = self._plot(box)
        low, high = span
        pixel = plot.height / (high - low)
        key = ("chart", column, span, box.size)
        if key not in self._kept:
            self._kept[key] = self._chart_ground(box, plot, name, span, limit, limit_name)
        self.surface.blit(self._kept[key], box)
        values = rows[:, column]
        x = plot.left + (rows[:, _T] - begin) * (plot.width / WINDOW_S)
        y = plot.bottom - (np.clip(values, low, high) - low) * pixel
        self.surface.set_clip(plot)
        for start, end, _ in self._pulses:
            left, right = (plot.left + (at - begin) * plot.width / WINDOW_S for at in (start, end))
            if right > plot.left and start <= rows[-1, _T]:
                pygame.draw.rect(self.surface, (96, 48, 36), (left, plot.top, max(right - left, 2), plot.height))
        limit_y = round(plot.bottom - (limit - low) * pixel)
        _dashed(self.surface, _TEXT, (plot.left, limit_y), (plot.right, limit_y), self._px(6), 1)
        for part in _runs(np.isfinite(values)):
            points = np.column_stack([x[part], y[part]]).tolist()
            if len(points) > 1:
                pygame.draw.lines(self.surface, self.accent, False, points, self._px(2))
                pygame.draw.aalines(self.surface, self.accent, False, points)
        # Where the link is broken, a bar along the foot says so.
        for part in _runs(rows[:, _INSIDE] < 0.5):
            width = max(x[part][-1] - x[part][0], 2)
            pygame.draw.rect(self.surface, RED, (x[part][0], plot.bottom - self._px(4), width, self._px(4)))
        self.surface.set_clip(None)
        now = values[-1]
        good = bool(now >= limit) if column == _RATE else bool(now <= limit)
        words = f"{now:.{digits}f}" if math.isfinite(now) else "no light"
        if math.isfinite(now):
            pygame.draw.circle(self.surface, self.accent, (x[-1], y[-1]), self._px(4))
        self._write(words, 24, (plot.right, box.top + self._px(4)), GREEN if good else RED, "topright")

    def _chart_ground(
        self, box: pygame.Rect, plot: pygame.Rect, name: str, span: tuple[float, float], limit: float, limit_name: str
    ) -> pygame.Surface:
        whole, place = self.surface, box.copy()
        ground = pygame.Surface(box.size, 0, whole)
        self.surface = ground
        offset = (-place.left, -place.top)
        self._box(place.move(offset))
        inner = plot.move(offset)
        pygame.draw.rect(ground, _GROUND, inner)
        low, high = span
        step = next(s for s in (0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 1e9) if (high - low) / s <= 4.0)
        value = math.ceil(low / step) * step
        while value <= high + 1e-9:
            y = round(inner.bottom - (value - low) / (high - low) * inner.height)
            pygame.draw.line(ground, _GRID, (inner.left, y), (inner.right, y))
            if y > inner.top + self._px(2):
                self._write(f"{value:g}", 18, (inner.left - self._px(5), y), _DIM, "midright")
            value += step
        title = self._write(name, 21, (inner.left, self._px(5)))
        self._write(f"– –  {limit_name} {limit:.3g}", 19, (title.right + self._px(14), self._px(6)), _DIM)
        self.surface = whole
        return ground

    def _keep(self, key: Any, make: Any) -> pygame.Surface:
        if key not in self._kept:
            made = make()
            # The pixel format of the frame, so that copying is all that blitting takes.
            self._kept[key] = pygame.Surface(made.get_size(), 0, self.surface)
            self._kept[key].blit(made, (0, 0))
        return self._kept[key]


_AUV_BODY = np.array(
    [[0.9, 0.0], [0.75, 0.16], [0.45, 0.24], [-0.55, 0.24], [-0.9, 0.1], [-0.9, -0.1], [-0.55, -0.24], [0.45, -0.24],
     [0.75, -0.16]]
)  # fmt: skip
_AUV_FIN = np.array([[-0.45, 0.04], [-0.9, 0.04], [-0.9, -0.04], [-0.45, -0.04]])
_SHIP_HULL = np.array(
    [[1.5, 0.0], [1.15, 0.28], [0.6, 0.42], [-1.1, 0.42], [-1.2, 0.3], [-1.2, -0.3], [-1.1, -0.42], [0.6, -0.42],
     [1.15, -0.28]]
)  # fmt: skip
_SHIP_CABIN = np.array([[0.15, 0.26], [-0.75, 0.26], [-0.75, -0.26], [0.15, -0.26]])


_FONTS: dict[int, pygame.font.Font] = {}


def text_image(text: str, pixels: int, colour: Colour) -> pygame.Surface:
    """A line of text in pygame's own font, which looks the same everywhere."""
    if not _FONTS:
        # Whoever calls pygame.quit(), as Gymnasium's HumanRendering does, ends them: to use one then ends the process.
        pygame.font.init()
        pygame.register_quit(_FONTS.clear)
    if pixels not in _FONTS:
        _FONTS[pixels] = pygame.font.Font(None, 3 * pixels)
    # Small letters are set unevenly; set large and shrunk they aren't.
    large = _FONTS[pixels].render(text, True, colour)
    width, height = large.get_size()
    return pygame.transform.smoothscale(large, (max(1, width // 3), max(1, height // 3)))


def _rate_words(rate: float) -> str:
    for scale, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if rate >= scale:
            return f"{rate / scale:.2g} {prefix}b/s"
    return f"{rate:.2g} b/s"


def _nice(value: float) -> float:
    return next((float(top) for top in (6, 8, 12, 16, 24, 32, 48) if top >= value), value)


def _blend(first: Sequence[float], second: Sequence[float], share: float) -> Colour:
    red, green, blue = (round(a + (b - a) * float(share)) for a, b in zip(first, second, strict=True))
    return red, green, blue


def _runs(mask: npt.NDArray[np.bool_]) -> list[slice]:
    """The stretches where a mask is set."""
    padded = np.zeros(mask.size + 2, dtype=bool)
    padded[1:-1] = mask
    edges = np.flatnonzero(padded[1:] != padded[:-1]).tolist()
    return [slice(start, end) for start, end in zip(edges[::2], edges[1::2], strict=True)]


def _hull(points: Array) -> Array:
    """The convex hull of points (N, 2)."""
    ordered = sorted(points.tolist())

    def half(given: list[list[float]]) -> list[list[float]]:
        chain: list[list[float]] = []
        for p in given:
            while len(chain) > 1:
                a, b = chain[-2:]
                if (b[0] - a[0]) * (p[1] - a[1]) > (b[1] - a[1]) * (p[0] - a[0]):
                    break
                chain.pop()
            chain.append(p)
        return chain[:-1]

    return np.array(half(ordered) + half(ordered[::-1]))


def _dashed(
    surface: pygame.Surface, colour: Colour, start: Sequence[float], end: Sequence[float], dash: int, width: int
) -> None:
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = math.hypot(dx, dy)
    for k in range(0, int(length / dash), 2):
        a, b = k * dash / length, min((k + 1) * dash / length, 1.0)
        ends = (start[0] + a * dx, start[1] + a * dy), (start[0] + b * dx, start[1] + b * dy)
        pygame.draw.line(surface, colour, *ends, width)


def _gradient(size: tuple[int, int]) -> pygame.Surface:
    share = np.linspace(0.0, 1.0, size[1])[None, :, None] ** 0.8
    colours = np.array(_SHALLOW) + (np.array(_DEEP) - np.array(_SHALLOW)) * share
    return pygame.surfarray.make_surface(np.broadcast_to(colours, (size[0], size[1], 3)).astype(np.uint8))


def _scale(size: tuple[int, int]) -> pygame.Surface:
    places = np.linspace(0.0, len(_MAP) - 1, size[0])
    colours = np.column_stack([np.interp(places, np.arange(len(_MAP)), c) for c in _MAP.T])
    return pygame.surfarray.make_surface(np.broadcast_to(colours[:, None], (*size, 3)).astype(np.uint8))


class Window:
    """A window on the display that shows surfaces.

    Args:
        size: Width and height [px].
        caption: The window's title.

    Raises:
        NoDisplayError: There is no display.
    """

    def __init__(self, size: tuple[int, int], caption: str) -> None:
        chosen = os.environ.get("SDL_VIDEODRIVER")
        try:
            pygame.display.init()
            # Without a display SDL may draw where nobody sees it, which is only right if that was asked for.
            if not chosen and pygame.display.get_driver() in ("offscreen", "dummy"):
                pygame.display.quit()
                raise pygame.error("SDL found none")
            self._screen = pygame.display.set_mode(size)
        except pygame.error as error:
            raise NoDisplayError(
                f'there is no display to open a window on ({error}); use render_mode="rgb_array", which needs none.'
            ) from None
        pygame.display.set_caption(caption)
        self._clock = pygame.time.Clock()
        self.closed = False

    def show(self, surface: pygame.Surface, frames_per_s: float) -> list[pygame.event.Event]:
        """Show a surface, wait until its time is over, and return what the user did meanwhile.

        Once the user has closed the window, `closed` is True and nothing more is shown.
        """
        if self.closed:
            return []
        self._screen.blit(surface, (0, 0))
        pygame.display.flip()
        self._clock.tick(frames_per_s)
        events = pygame.event.get()
        if any(event.type == pygame.QUIT for event in events):
            self.close()
        return events

    def close(self) -> None:
        """Close the window."""
        if not self.closed:
            self.closed = True
            pygame.display.quit()

"""Where a picture of plants is seen from: in parallel from the side, or in perspective."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from urbanforest_cli.export.plant_scene import FloatArray


@dataclass(frozen=True)
class Camera:
    """Where a picture is seen from.

    Parameters
    ----------
    eye_m
        (3,) the viewer, or in parallel projection the point at `middle_px`.
    azimuth_deg, pitch_deg
        Where the viewer looks: 0 is north, 90 east; degrees downward.
    scale_px
        Pixels a metre in parallel projection; in perspective, pixels for a slope of 1.
    size_px, middle_px
        Width and height, and the pixel that the viewer looks straight at.
    perspective
        Whether what is far looks small.
    """

    eye_m: tuple[float, float, float]
    azimuth_deg: float
    pitch_deg: float
    scale_px: float
    size_px: tuple[int, int]
    middle_px: tuple[float, float]
    perspective: bool = False

    @property
    def axes(self) -> FloatArray:
        """(3, 3) rows right, up and toward the viewer."""
        azimuth, pitch = np.deg2rad(self.azimuth_deg), np.deg2rad(self.pitch_deg)
        ahead = np.array([np.sin(azimuth) * np.cos(pitch), np.cos(azimuth) * np.cos(pitch), -np.sin(pitch)])
        right = np.array([np.cos(azimuth), -np.sin(azimuth), 0.0])
        return np.asarray(np.stack((right, np.cross(right, ahead), -ahead)))

    def enlarged(self, factor: int) -> Camera:
        """Return the same view with more pixels."""
        width, height = self.size_px
        return Camera(self.eye_m, self.azimuth_deg, self.pitch_deg, self.scale_px * factor,
                      (width * factor, height * factor), (self.middle_px[0] * factor, self.middle_px[1] * factor),
                      self.perspective)  # fmt: skip

    def seen(self, points: FloatArray) -> FloatArray:
        """Return (n, 4): x and y in pixels, depth in metres, pixels a metre there."""
        local = (np.asarray(points, dtype=np.float64) - np.array(self.eye_m)) @ self.axes.T
        depth = -local[:, 2]
        if self.perspective:
            scale = self.scale_px / np.maximum(depth, 1e-3)
        else:
            depth, scale = depth + 1e4, np.full(len(local), self.scale_px)
        return np.column_stack((self.middle_px[0] + local[:, 0] * scale, self.middle_px[1] - local[:, 1] * scale,
                                depth, scale))  # fmt: skip


def side_view(
    left_m: float, width_m: float, px_per_m: float, *, above_m: float, below_m: float = 1.0, pitch_deg: float = 6.0
) -> Camera:
    """Look north at what stands along y = 0, without perspective."""
    size = (round(width_m * px_per_m), round((above_m + below_m) * px_per_m))
    return Camera((left_m, 0.0, 0.0), 0.0, pitch_deg, px_per_m, size, (0.0, above_m * px_per_m))


def view_from(
    eye_m: tuple[float, float, float], target_m: tuple[float, float, float], *, size_px: tuple[int, int],
    field_deg: float,
) -> Camera:  # fmt: skip
    """Look from one point to another with perspective; `field_deg` is the angle the picture's width takes."""
    dx, dy, dz = (b - a for a, b in zip(eye_m, target_m, strict=True))
    azimuth, pitch = np.rad2deg(np.arctan2(dx, dy)), np.rad2deg(np.arctan2(-dz, np.hypot(dx, dy)))
    scale = size_px[0] / 2 / np.tan(np.deg2rad(field_deg) / 2)
    return Camera(eye_m, float(azimuth), float(pitch), float(scale), size_px, (size_px[0] / 2, size_px[1] / 2), True)


def view_onto(
    points: FloatArray, *, azimuth_deg: float, pitch_deg: float, distance_m: float, size_px: tuple[int, int],
    margin_px: float = 12.0,
) -> Camera:  # fmt: skip
    """Look at points (n, 3) from a distance and a direction, so that they just fill the picture."""
    middle = (np.max(points, axis=0) + np.min(points, axis=0)) / 2
    camera = Camera((0.0, 0.0, 0.0), azimuth_deg, pitch_deg, 1.0, size_px, (0.0, 0.0), True)
    eye = middle + distance_m * camera.axes[2]
    camera = Camera((float(eye[0]), float(eye[1]), float(eye[2])), azimuth_deg, pitch_deg, 1.0, size_px, (0.0, 0.0),
                    True)  # fmt: skip
    seen = camera.seen(points)[:, :2]
    low, high = seen.min(axis=0), seen.max(axis=0)
    scale = float(((np.array(size_px) - 2 * margin_px) / np.maximum(high - low, 1e-9)).min())
    corner = np.array(size_px) / 2 - scale * (low + high) / 2
    return Camera(camera.eye_m, azimuth_deg, pitch_deg, scale, size_px, (float(corner[0]), float(corner[1])), True)

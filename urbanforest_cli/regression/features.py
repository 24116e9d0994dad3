"""What a program can say of the coverage of a lot in numbers."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.lot_windows import WINDOW_PX, LotWindows
from urbanforest_cli.regression.windows_kernel import write_features

WINDOWS_A_CHUNK = 128
NETWORK_PX = 64

HAND_FEATURES: tuple[str, ...] = (
    "lot_area_log", "ground_area_log", "ground_share", "rim_share", "lot_depth_m", "pixel_m",
    "lot_cover", "ground_cover",
    "region_count_log", "regions_a_1000m2", "region_radius_mean_m", "region_radius_sd_m", "region_radius_min_m",
    "region_radius_q25_m", "region_radius_q50_m", "region_radius_q75_m", "region_radius_max_m",
    "region_largest_share", "region_roundness", "region_depth_mean_m", "region_depth_sd_m", "region_depth_max_m",
    "round_count_log", "round_radius_mean_m", "round_radius_variance_m2",
    "thick_0.75m", "thick_1.5m", "thick_2.5m", "thick_3.5m", "thick_5m", "thick_7m",
    "cover_to_1m", "cover_to_2m", "cover_to_3m", "cover_to_4.5m", "cover_to_6m", "cover_to_9m", "cover_beyond_9m",
    "covered_edge_q95_m", "covered_edge_q50_m",
    "group_count_log", "group_radius_mean_m", "group_radius_max_m", "group_length_mean_m", "group_cover",
)  # fmt: skip
"""Shares, connected regions, thicknesses, cover by distance from the lot's edge, and groups after closing gaps."""

CROWN_FEATURES: tuple[str, ...] = (
    "crown_count_log", "crown_count_inverse", "crown_radius_mean_m", "crown_radius_variance_m2", "crown_radius_sd_m",
    "crown_radius_min_m", "crown_radius_q25_m", "crown_radius_q50_m", "crown_radius_q75_m", "crown_radius_max_m",
    "seen_count_log", "seen_radius_mean_m", "seen_radius_variance_m2", "crown_rim_seen", "crown_radius_iqr_sd_m",
    "gap_mean", "gap_min", "gap_q50", "gap_max", "near_3", "near_5", "near_8",
    "edge_mean_m", "edge_min_m", "edge_q25_m", "edge_q50_m", "edge_q75_m", "edge_q90_m", "edge_max_m", "edge_second_m",
    "edge_max_seen_m", "clearance_m", "house_q10_m",
    "crown_cover", "filled", "filled_band", "full_log", "full_band_log", "band_share", "band_log_likelihood",
    "edge_to_ground", "within_1", "within_1.5", "within_2", "within_3", "within_4.5", "within_7", "farthest",
    "filled_2", "filled_3", "filled_4.5", "free_area_log", "band_width_m",
    "groups_1", "group_share_1", "group_reach_1_m", "groups_2.5", "group_share_2.5", "group_reach_2.5_m",
    "groups_4", "group_share_4", "group_reach_4_m", "spread_long_m", "spread_short_m", "group_reach_mean_m", "spread",
)  # fmt: skip
"""Of crowns told apart in the lot: radii; gaps, neighbours and empty space in mean radii; distances to the lot's edge
and to houses; their number over what would fill the ground, its band along the edge, or what lies around them; groups
that they form."""

FEATURES: tuple[str, ...] = HAND_FEATURES + CROWN_FEATURES
"""All features, in the order of the columns."""


def features_of(windows: LotWindows, *, workers: int = 1) -> NDArray[np.float32]:
    """Return the features of windows, each by itself.

    Returns
    -------
    (n, len(FEATURES)) float32, never NaN; what a bare window has none of is 0.
    """
    found = np.zeros((len(windows), len(FEATURES)), np.float32)

    def write(start: int) -> None:
        part = slice(start, start + WINDOWS_A_CHUNK)
        some = windows.take(part)
        write_features(
            some.coverage, some.lot, some.ground, some.edge_dm, some.pixel_m.astype(np.float64), some.lot_area_m2,
            some.ground_area_m2, found[part],
        )  # fmt: skip

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(write, range(0, len(windows), WINDOWS_A_CHUNK)))
    return found


def network_windows(windows: LotWindows) -> NDArray[np.uint8]:
    """Return what a network sees: windows of 64 pixels of twice the side.

    Returns
    -------
    (n, 3, 64, 64) uint8: coverage and ground in percent, distance to the lot's edge in decimetres.
    """
    shape = (len(windows), NETWORK_PX, WINDOW_PX // NETWORK_PX, NETWORK_PX, WINDOW_PX // NETWORK_PX)
    channels = [
        channel.reshape(shape).sum(axis=(2, 4), dtype=np.uint16)
        for channel in (windows.coverage, windows.ground, windows.edge_dm)
    ]
    cells = shape[2] * shape[4]
    return np.asarray((np.stack(channels, axis=1) + cells // 2) // cells).astype(np.uint8)

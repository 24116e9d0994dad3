"""The arrays a grove grows in: internodes, buds, plants and the grids of light and room."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

APICAL, LATERAL, RESERVE, STEM = 0, 1, 2, 3
APICAL_NUMBER, RESERVE_NUMBER = 14, 15  # places of these buds at their node; lateral ones and stems count from 0
FREE, TAKEN, BLOCKED = 0, 1, 2
RAY_REACH = (1, 2, 4)  # voxel edges
SHADE_UNIT = 4096  # fixed point of shade: sums are exact in any order, and taking away leaves what was there before


class Nodes(NamedTuple):
    """Internodes in the order they grew, parents first; lost ones stay."""

    parent: NDArray[np.int32]
    plant: NDArray[np.int32]
    serial: NDArray[np.int32]  # number within the plant
    xyz: NDArray[np.float32]  # (n, 3) in the frame
    order: NDArray[np.uint8]
    leads: NDArray[np.uint8]  # 1 where it goes on with its parent's axis
    birth: NDArray[np.uint8]
    death: NDArray[np.uint8]
    light: NDArray[np.float32]  # caught by all buds at or above
    able: NDArray[np.float32]  # of that, by buds that have room to grow
    weighted: NDArray[np.float32]  # that of children and own buds, each by its share in apical control
    vigour: NDArray[np.float32]
    inhibition: NDArray[np.float32]
    above: NDArray[np.int32]  # living internodes at or above
    live: NDArray[np.int32]  # indices of the living, ascending


class Buds(NamedTuple):
    """Living buds."""

    node: NDArray[np.int32]
    voxel: NDArray[np.int32]
    direction: NDArray[np.float32]  # (b, 3)
    roll: NDArray[np.float32]
    light: NDArray[np.float32]
    vigour: NDArray[np.float32]
    kind: NDArray[np.uint8]
    number: NDArray[np.uint8]  # among the buds of its node
    spent: NDArray[np.uint8]  # 1: to be removed; 2: no room as long as no marker is released


class Plants(NamedTuple):
    """One row a plant."""

    key: NDArray[np.uint64]
    root_xy: NDArray[np.float32]  # (p, 2) in the frame
    species: NDArray[np.int64]
    seasons: NDArray[np.int64]
    first_year: NDArray[np.float64]  # share of a year that the first season lasts
    pruning_factor: NDArray[np.float64]
    clearance: NDArray[np.float64]
    azimuth: NDArray[np.float64]
    root: NDArray[np.int64]  # node, -1 before planting
    node_count: NDArray[np.int64]
    now: NDArray[np.int64]  # own season, 0 before planting
    age: NDArray[np.float64]  # years at the end of this season
    vitality: NDArray[np.float64]  # age by which shoots shorten: a cut makes it younger
    grown_at: NDArray[np.int64]  # own season of the last growth
    years: NDArray[np.float64]  # that this season's growth stands for; 0: none this season
    dark: NDArray[np.int64]  # seasons in a row without light
    state: NDArray[np.int8]  # 0 living, 1 died, 2 no room
    death: NDArray[np.int32]
    pruned_at: NDArray[np.int64]  # own season of the cut, 0 none yet
    shed: NDArray[np.int64]
    pruned: NDArray[np.int64]
    height: NDArray[np.float32]


class Grids(NamedTuple):
    """Light and room around the grove, flattened with x fastest."""

    shade: NDArray[np.int32]
    voxel_shape: NDArray[np.int64]  # (3,) z, y, x
    voxel_m: float
    pad: int  # voxels around the frame on each side, so that no pyramid leaves the grid
    lean: NDArray[np.int64]  # (depth + 1, 2) voxels that a layer of the pyramid is moved
    cast: NDArray[np.int32]  # (species + 1, depth + 1) shade cast into a layer; the last row for other groves' plants
    marker: NDArray[np.uint8]
    marker_shape: NDArray[np.int64]
    marker_m: float
    jitter: NDArray[np.float32]  # (4096, 3)
    near: NDArray[np.float32]  # squared distance of the nearest bud, a scratch of the marker grid
    owner: NDArray[np.int32]
    solid_top: NDArray[np.float32]
    column_m: float
    sky: NDArray[np.uint8]
    sky_m: float
    ray: NDArray[np.float32]
    ray_light: NDArray[np.float32]
    ray_step: NDArray[np.int64]  # (k, 3) from a voxel to those RAY_REACH edges away along each ray
    size: NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def new_nodes(capacity):
    """Return room for internodes, all zero."""
    return Nodes(
        np.zeros(capacity, np.int32),
        np.zeros(capacity, np.int32),
        np.zeros(capacity, np.int32),
        np.zeros((capacity, 3), np.float32),
        np.zeros(capacity, np.uint8),
        np.zeros(capacity, np.uint8),
        np.zeros(capacity, np.uint8),
        np.zeros(capacity, np.uint8),
        np.zeros(capacity, np.float32),
        np.zeros(capacity, np.float32),
        np.zeros(capacity, np.float32),
        np.zeros(capacity, np.float32),
        np.zeros(capacity, np.float32),
        np.zeros(capacity, np.int32),
        np.zeros(capacity, np.int32),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def new_buds(capacity):
    """Return room for buds, all zero."""
    return Buds(
        np.zeros(capacity, np.int32),
        np.zeros(capacity, np.int32),
        np.zeros((capacity, 3), np.float32),
        np.zeros(capacity, np.float32),
        np.zeros(capacity, np.float32),
        np.zeros(capacity, np.float32),
        np.zeros(capacity, np.uint8),
        np.zeros(capacity, np.uint8),
        np.zeros(capacity, np.uint8),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def nodes_with_room(nodes, count, need):
    """Return the same internodes with room for `need` more."""
    if count + need <= len(nodes.parent):
        return nodes
    larger = new_nodes(max(count + need, count + count // 4))
    larger.parent[:count] = nodes.parent[:count]
    larger.plant[:count] = nodes.plant[:count]
    larger.serial[:count] = nodes.serial[:count]
    larger.xyz[:count] = nodes.xyz[:count]
    larger.order[:count] = nodes.order[:count]
    larger.leads[:count] = nodes.leads[:count]
    larger.birth[:count] = nodes.birth[:count]
    larger.death[:count] = nodes.death[:count]
    larger.light[:count] = nodes.light[:count]
    larger.able[:count] = nodes.able[:count]
    larger.weighted[:count] = nodes.weighted[:count]
    larger.vigour[:count] = nodes.vigour[:count]
    larger.inhibition[:count] = nodes.inhibition[:count]
    larger.above[:count] = nodes.above[:count]
    larger.live[:count] = nodes.live[:count]
    return larger


@njit(cache=True, nogil=True, error_model="numpy")
def buds_with_room(buds, count, need):
    """Return the same buds with room for `need` more."""
    if count + need <= len(buds.node):
        return buds
    larger = new_buds(max(count + need, count + count // 4))
    larger.node[:count] = buds.node[:count]
    larger.voxel[:count] = buds.voxel[:count]
    larger.direction[:count] = buds.direction[:count]
    larger.roll[:count] = buds.roll[:count]
    larger.light[:count] = buds.light[:count]
    larger.vigour[:count] = buds.vigour[:count]
    larger.kind[:count] = buds.kind[:count]
    larger.number[:count] = buds.number[:count]
    larger.spent[:count] = buds.spent[:count]
    return larger


@njit(cache=True, nogil=True, error_model="numpy")
def hash_bits(key, serial, number, purpose):
    """Hash a plant's key and a bud to 64 bits (finaliser of SplitMix64; Steele, Lea and Flood 2014)."""
    place = np.uint64(serial) * np.uint64(128) + np.uint64(number) * np.uint64(8) + np.uint64(purpose)
    z = key + (place + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@njit(cache=True, nogil=True, error_model="numpy")
def season_key(plants, plant):
    """Return a plant's key for its present season."""
    return plants.key[plant] ^ (np.uint64(plants.now[plant]) * np.uint64(0xD1342543DE82EF95))


@njit(cache=True, nogil=True, error_model="numpy")
def uniform(bits):
    """Return a number in [0, 1) from hashed bits."""
    return float(bits >> np.uint64(11)) * 1.1102230246251565e-16


@njit(cache=True, nogil=True, error_model="numpy")
def deviate(bits):
    """Return a bell-shaped number of mean 0 and variance 1, within +-3: the sum of three uniform ones."""
    low = np.uint64(0x1FFFFF)
    total = float(bits & low) + float((bits >> np.uint64(21)) & low) + float((bits >> np.uint64(42)) & low)
    return total * (2.0 / 2097152.0) - 3.0

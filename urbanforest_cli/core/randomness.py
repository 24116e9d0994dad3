"""Random streams keyed by (seed, stage, item), so that results know no order and no worker count."""

from __future__ import annotations

from collections.abc import Iterable
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray


def key_for(seed: int, stage: str, item: str) -> int:
    """Return the 64-bit key of one stream."""
    text = f"{seed}\x1f{stage}\x1f{item}".encode("utf-8", "surrogatepass")
    return int.from_bytes(blake2b(text, digest_size=8).digest(), "little")


def keys_for(seed: int, stage: str, items: Iterable[str]) -> NDArray[np.uint64]:
    """Return one 64-bit key an item, the same whatever its neighbours in the list."""
    start = blake2b(f"{seed}\x1f{stage}\x1f".encode(), digest_size=8)
    keys = bytearray()
    for item in items:
        digest = start.copy()
        digest.update(item.encode("utf-8", "surrogatepass"))
        keys += digest.digest()
    return np.frombuffer(bytes(keys), dtype="<u8").astype(np.uint64)


def rng_for(seed: int, stage: str, item: str) -> np.random.Generator:
    """Return the generator of one stream."""
    return rng_from_key(key_for(seed, stage, item))


def rng_from_key(key: int) -> np.random.Generator:
    """Return the generator of a key made by `key_for` or `keys_for`."""
    return np.random.Generator(np.random.Philox(key=int(key)))


def hash_uniform(keys: NDArray[np.uint64], index: NDArray[np.integer]) -> NDArray[np.float64]:
    """Hash (key, index) pairs to numbers in [0, 1) with 53 random bits.

    The finaliser of SplitMix64 (Steele, Lea and Flood 2014) over the key plus an odd multiple of the index.
    """
    with np.errstate(over="ignore"):
        z = keys + (index.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
    return np.asarray((z >> np.uint64(11)).astype(np.float64) * 2.0**-53)

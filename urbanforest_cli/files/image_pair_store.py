"""Pixels and truths of blocks kept in memory, since every epoch of a training asks for them again."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.files.image_pair_blocks import Block, ImageOptions, Pixels, read_block

KEPT_BYTES = 1 << 30


class BlockStore:
    """Reads blocks and remembers those asked for last, up to a limit; what is more is read again.

    Parameters
    ----------
    options
        How images are opened.
    nir
        Whether their near infrared is read too.
    kept_bytes
        The limit.
    """

    def __init__(self, options: ImageOptions, *, nir: bool, kept_bytes: int = KEPT_BYTES) -> None:
        self._options = options
        self._nir = nir
        self._limit = kept_bytes
        self._pixels: OrderedDict[str, Pixels] = OrderedDict()
        self._truths: OrderedDict[str, NDArray[np.uint8]] = OrderedDict()
        self._bytes = 0
        self._lock = Lock()

    def pixels(self, block: Block) -> Pixels:
        """Return a block's pixels; from any thread.

        Raises
        ------
        InputError
            The file is damaged or has changed.
        """
        with self._lock:
            if (known := self._pixels.get(block.name)) is not None:
                self._pixels.move_to_end(block.name)
                return known
        made = read_block(block, self._options, nir=self._nir)
        with self._lock:
            if block.name not in self._pixels:
                self._pixels[block.name] = made
                self._bytes += made.nbytes
            self._forget()
        return made

    def truth(self, block: Block, make: Callable[[], NDArray[np.uint8]]) -> NDArray[np.uint8]:
        """Return a block's truth, made by `make` where it is not known; from any thread."""
        with self._lock:
            if (known := self._truths.get(block.name)) is not None:
                self._truths.move_to_end(block.name)
                return known
        made = make()
        with self._lock:
            if block.name not in self._truths:
                self._truths[block.name] = made
                self._bytes += made.nbytes
            self._forget()
        return made

    def _forget(self) -> None:
        """Let go of pixels first: a truth costs more to make again."""
        while self._bytes > self._limit and (self._pixels or self._truths):
            kept: OrderedDict[str, Pixels] | OrderedDict[str, NDArray[np.uint8]] = self._pixels or self._truths
            self._bytes -= kept.popitem(last=False)[1].nbytes

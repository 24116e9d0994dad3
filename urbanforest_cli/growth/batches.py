"""Many groves, few threads: parts that hold groves, and results that come in the order of their questions."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from hashlib import blake2b
from itertools import islice
from typing import TypeVar

PLANTS_A_PART = 400
LOTS_A_PART = 32
AHEAD = 3  # results a thread may be ahead of the one that is awaited

Question = TypeVar("Question")
Answer = TypeVar("Answer")


def cut_into_parts(lots: Sequence[str], plant_counts: Sequence[int]) -> list[range]:
    """Cut a row of groves into parts, so that a change of one lot changes its own part and seldom more.

    A part begins at a lot whose id says so by its hash, one in 32, whatever stands before it; and where it would hold
    too many plants.

    Parameters
    ----------
    lots, plant_counts
        Lot and number of plants of each grove.
    """
    parts: list[range] = []
    start = count = 0
    for place, (lot, plants) in enumerate(zip(lots, plant_counts, strict=True)):
        new_lot = place > 0 and lot != lots[place - 1]
        if place > start and (count + plants > PLANTS_A_PART or (new_lot and _begins_part(lot))):
            parts.append(range(start, place))
            start, count = place, 0
        count += plants
    if start < len(lots):
        parts.append(range(start, len(lots)))
    return parts


def _begins_part(lot: str) -> bool:
    digest = blake2b(lot.encode("utf-8", "surrogatepass"), digest_size=8).digest()
    return int.from_bytes(digest, "little") % LOTS_A_PART == 0


def answers_in_order(
    questions: Iterable[Question], answer: Callable[[Question], Answer], workers: int
) -> Iterator[Answer]:
    """Yield the answers to questions in their order, worked out by some threads.

    Threads run ahead of the answer that is awaited by a few questions each, so that memory is bounded by those,
    however slowly the answers are taken.
    """
    if workers <= 1:
        yield from map(answer, questions)
        return
    waiting: deque[Future[Answer]] = deque()
    source = iter(questions)
    pool = ThreadPoolExecutor(workers)
    try:
        waiting.extend(pool.submit(answer, question) for question in islice(source, AHEAD * workers))
        while waiting:
            first = waiting.popleft()
            yield first.result()
            waiting.extend(pool.submit(answer, question) for question in islice(source, 1))
    finally:
        pool.shutdown(wait=True, cancel_futures=True)

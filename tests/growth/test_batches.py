import threading

import pytest

from urbanforest_cli.growth.batches import AHEAD, PLANTS_A_PART, answers_in_order, cut_into_parts


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_answers_come_in_the_order_of_questions(workers):
    waits = [threading.Event() for _ in range(30)]

    def answer(number):
        if workers > 1 and number % 2 == 0 and number + 1 < len(waits):
            waits[number + 1].wait(5)  # the odd one after it is answered first
        waits[number].set()
        return number * number

    assert list(answers_in_order(range(30), answer, workers)) == [number * number for number in range(30)]


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_threads_run_ahead_of_the_taker_by_a_few_questions_alone(workers):
    asked = 0

    def questions():
        nonlocal asked
        for number in range(1000):
            asked += 1
            yield number

    taken = answers_in_order(questions(), lambda number: number, workers)
    for count in range(1, 50):
        next(taken)
        assert asked <= count + AHEAD * workers
    taken.close()


def test_a_fault_in_a_thread_comes_out_and_stops_the_rest():
    answered = []

    def answer(number):
        if number == 3:
            raise RuntimeError("broken")
        answered.append(number)
        return number

    with pytest.raises(RuntimeError, match="broken"):
        list(answers_in_order(range(100_000), answer, 2))
    assert len(answered) < 100


LOTS = [f"lot-{number:05d}" for number in range(2000) for _ in range(1 + number % 3)]


def parts_of(lots, plants):
    return [tuple(lots[place] for place in part) for part in cut_into_parts(lots, plants)]


def test_parts_hold_every_grove_once_and_not_too_many_plants():
    plants = [1 + place % 48 for place in range(len(LOTS))]
    parts = cut_into_parts(LOTS, plants)
    assert [place for part in parts for place in part] == list(range(len(LOTS)))
    assert max(sum(plants[place] for place in part) for part in parts) <= PLANTS_A_PART
    assert cut_into_parts([], []) == []
    assert [len(part) for part in cut_into_parts(["a", "b"], [10**6, 10**6])] == [1, 1]


def test_one_lot_more_changes_few_parts():
    plants = [4] * len(LOTS)
    before = set(parts_of(LOTS, plants))
    lots = [*LOTS[:2000], "lot-01000b", *LOTS[2000:]]
    after = set(parts_of(lots, [4] * len(lots)))
    assert len(after - before) <= 3
    assert len(before) > 30

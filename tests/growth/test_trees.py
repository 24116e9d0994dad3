import numpy as np
import pytest

from urbanforest_cli.core.errors import SchemaError
from urbanforest_cli.growth.accounts import Accounts, joined
from urbanforest_cli.growth.city import skeleton_numbers
from urbanforest_cli.growth.grove import DIED, GROWN, NO_ROOM
from urbanforest_cli.growth.trees import Stand, tree_columns


def accounts_of(outcome, seasons, death):
    count = len(outcome)
    columns = {name: np.zeros(count, np.int64) for name in ("generated", "retained", "shed", "pruned")}
    sizes = {name: np.full(count, 2.0) for name in ("height_m", "crown_radius_m", "crown_base_m", "dbh_m")}
    return Accounts(
        skeleton_id=np.arange(count)[::-1] + 10,
        outcome=np.array(outcome),
        seasons=np.array(seasons),
        death_season=np.array(death),
        internode_count=np.full(count, 5),
        **columns,
        **sizes,
    )


@pytest.fixture
def stand():
    """Four plants: one of its own, one that shares the first's shape, one that died, one without a skeleton."""
    stand = Stand.bare(5)
    stand.reason[:] = "no_room"
    stand.put_own(np.array([0, 2, 4]), np.array([12, 11, 10]))
    stand.skeleton_id[1], stand.library[1], stand.scale[1], stand.reason[1] = 12, True, 1.1, None
    return stand


ACCOUNTS = accounts_of([GROWN, DIED, NO_ROOM], [20, 20, 20], [0, 12, 0])
SEASONS = np.array([20, 14, 20, 9, 20])


def test_today(stand):
    columns = tree_columns(stand, ACCOUNTS, SEASONS)
    assert columns["grown"].tolist() == ["unique", "library", "dead", "none", "none"]
    assert columns["reason"].tolist() == [None, None, "died", "no_room", "no_room"]
    assert columns["height_m"].tolist() == [2.0, 2.2, 0.0, 0.0, 0.0]
    assert columns["internode_count"].tolist() == [5, 5, 0, 0, 0]
    assert columns["skeleton_id"].isna().tolist() == [False, False, False, True, True]


def test_ten_years_ago_the_dead_stood_and_fifteen_years_ago_some_were_not_planted(stand):
    columns = tree_columns(stand, ACCOUNTS, SEASONS, years_ago=10)
    assert columns["grown"].tolist() == ["unique", "library", "unique", "none", "none"]
    columns = tree_columns(stand, ACCOUNTS, SEASONS, years_ago=14)
    assert columns["grown"].tolist() == ["unique", "none", "unique", "none", "none"]
    assert columns["reason"].tolist() == [None, "unborn", None, "no_room", "no_room"]
    assert columns["height_m"][1] == 0
    assert not columns["skeleton_id"].isna()[1]


def test_accounts_come_back_as_they_were_written():
    again = Accounts.from_record(ACCOUNTS.as_record())
    assert all((again.columns()[name] == values).all() for name, values in ACCOUNTS.columns().items())
    assert len(joined([])) == 0
    assert joined([ACCOUNTS, again]).outcome.tolist() == [*ACCOUNTS.outcome, *ACCOUNTS.outcome]


@pytest.mark.parametrize(
    "harm",
    [{"outcome": [0, 1]}, {"outcome": [0, 1, 9]}, {"seasons": ["x", 1, 2]}, {"dbh_m": None}, {"shed": [[1], [2], [3]]}],
)
def test_broken_accounts_are_refused(harm):
    with pytest.raises(SchemaError, match="accounts"):
        Accounts.from_record(ACCOUNTS.as_record() | harm, where="part")


def test_a_skeletons_number_is_its_plants_own_and_no_two_are_alike(monkeypatch):
    names = [f"lot-{number}" for number in range(1000)]
    numbers = skeleton_numbers(names)
    assert numbers.max() < 2**53
    assert (skeleton_numbers(names[::-1])[::-1] == numbers).all()
    assert (skeleton_numbers(names[:10]) == numbers[:10]).all()
    monkeypatch.setattr("urbanforest_cli.growth.city.ID_BITS", 8)
    crowded = skeleton_numbers(names[:200])
    assert len(set(crowded.tolist())) == 200
    assert (skeleton_numbers(names[:200][::-1])[::-1] == crowded).all()

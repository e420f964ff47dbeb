"""The study of crowds: cases, summary and bar."""

from ambler.studies.crowd_study import crowd_cases, line, meets_bar, summarize


def result(world: str, robot: str, ended: str = "finished", collisions: int = 0, contacts: int = 0) -> dict:
    return {
        "world": world,
        "robot": robot,
        "ended": ended,
        "collisions": collisions,
        "contacts": contacts,
        "sim_seconds": 100.0,
        "reachable_coverage_ratio": 0.99,
    }


def test_worlds_and_robots_take_turns() -> None:
    cases = crowd_cases(["a", "b"], ["diff", "spot"], 10, 5, range(6))
    assert [(c.world, c.robot, c.seed) for c in cases] == [
        *(("a", "diff", 0), ("a", "spot", 1), ("b", "diff", 2), ("b", "spot", 3), ("a", "diff", 4), ("a", "spot", 5))
    ]
    assert len({c.label for c in cases}) == 6


def test_drawn_places_take_the_seed_of_their_run() -> None:
    cases = crowd_cases(["office-*", "two_rooms"], ["diff"], 10, 5, [7, 8, 9])
    assert [c.place for c in cases] == ["office-7", "two_rooms", "office-9"]
    assert len({c.label for c in cases}) == 3


def test_being_shoved_into_somebody_is_told_and_no_collision() -> None:
    fields = summarize([*[result("a", "diff")] * 29, {**result("a", "diff"), "collisions_shoved": 2}])
    assert fields["collisions_shoved"] == 2
    assert meets_bar(fields)


def test_the_bar_counts_caused_contacts_and_ends() -> None:
    good = [result("a", "diff", contacts=3) for _ in range(28)]
    assert meets_bar(summarize([*good, *(result("a", "spot", "stuck") for _ in range(2))]))
    assert not meets_bar(summarize([*good[:27], *(result("a", "spot", "stuck") for _ in range(3))]))
    assert not meets_bar(summarize([*good, result("a", "diff", collisions=1, contacts=1)]))
    crashed = {"world": "a", "robot": "diff", "ended": "crashed", "why": "died"}
    assert not meets_bar(summarize([result("a", "diff"), crashed]))
    fields = summarize([*good, crashed])
    assert (fields["runs"], fields["finished"], fields["contacts"], fields["a.diff.runs"]) == (29, 28, 84, 29)
    assert 0.0 < fields["runs_with_collision_ratio_max"] < 0.15
    assert "3 contacts" in line(good[0])


def test_a_proof_that_comes_too_early_is_none() -> None:
    good, early = result("a", "diff"), {**result("a", "diff"), "reachable_coverage_ratio": 0.6}
    fields = summarize([*[good] * 27, *[early] * 3])
    assert (fields["finished"], fields["finished_early"], fields["not_finished"]) == (27, 3, "")
    assert not meets_bar(fields)
    assert meets_bar(summarize([*[good] * 28, *[early] * 2]))
    assert line(early).startswith("finished early, ")
    assert line(good).startswith("finished, ")

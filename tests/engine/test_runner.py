"""Budgets, predictions, progress, failures: on a method that is arithmetic and a clock that is a number."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from etendue.core import OptionError, OutputError, Pass
from etendue.engine import Budget, Cancelled, Replicated, RunError, Runner
from etendue.engine.stopping import LEAST_PASSES_FOR_ERROR


@pytest.mark.parametrize(
    "limits",
    [
        {"seconds": 0},
        {"seconds": -1.0},
        {"seconds": float("nan")},
        {"seconds": float("inf")},
        {"seconds": "60"},
        {"samples": 0},
        {"samples": -4},
        {"samples": 1.5},
        {"samples": True},
        {"iterations": 0},
        {"error": 0.0},
        {"error": -0.1},
    ],
)
def test_a_budget_that_is_not_positive_is_refused(limits):
    with pytest.raises(OptionError, match=r"budget in .* must be"):
        Budget(**limits)


def test_samples_are_counted_in_passes_and_the_smaller_limit_holds():
    assert Budget(samples=10).passes(4) == 3
    assert Budget(samples=10, iterations=2).passes(4) == 2
    assert Budget(seconds=1).passes(4) is None
    assert not Budget()
    assert Budget(error=0.1)


def test_every_replica_knows_the_plan(noise):
    """Also those that are prepared when their first pass is due."""
    told = []
    planned = type("Planned", (type(noise),), {"plan": lambda self, *limits: told.append(limits)})
    Runner(Replicated(planned(), None, 0, 3), seed=0, budget=Budget(seconds=30.0, iterations=3)).run()
    assert told == [(30.0, 3, None)] * 3


def test_a_run_without_any_end_is_refused(noise):
    with pytest.raises(OptionError, match="needs a budget"):
        Runner(noise, seed=0, budget=Budget()).run()


@pytest.mark.parametrize(
    ("durations", "seconds", "passes"),
    [
        ([1.0], 10.0, 10),  # exactly filled
        ([3.0], 10.0, 3),  # a fourth would end at 12
        ([50.0], 10.0, 1),  # one pass at least
        ([6.0, 1.0], 10.0, 5),  # the first compiles: 6 + 4 * 1
        ([6.0, 5.0], 10.0, 2),  # nothing tells that the second is slow; a third is not begun
        ([1.0, 1.0, 4.0, 1.0], 9.0, 3),  # the slowest of the latest passes is what the next may take
    ],
)
def test_the_last_pass_is_predicted(timed, durations, seconds, passes):
    method, clock = timed(durations)
    result = Runner(method, seed=0, budget=Budget(seconds=seconds), clock=clock).run()
    assert result.passes == passes
    assert result.stopped_by == "seconds"
    assert result.elapsed == pytest.approx(sum(durations[:passes]) + durations[-1] * max(0, passes - len(durations)))
    assert result.measurement.counters["seconds"] == pytest.approx(result.elapsed)


def test_passes_that_a_product_needs_are_made_in_any_time(timed):
    method, clock = timed([6.0, 5.0])
    result = Runner(method, seed=0, budget=Budget(seconds=2.0), least=2, clock=clock).run()
    assert (result.passes, result.stopped_by, result.elapsed) == (2, "seconds", 11.0)
    assert Runner(method, seed=0, budget=Budget(seconds=2.0, samples=1), least=2, clock=clock).run().passes == 1


def test_what_only_the_first_pass_does_is_not_predicted(timed):
    method, clock = timed([8.0, 1.0])
    method.setup_seconds = 7.0
    result = Runner(method, seed=0, budget=Budget(seconds=12.0), clock=clock).run()
    assert result.passes == 5


def test_what_is_left_to_do_after_the_last_pass_is_a_part_of_the_time(timed):
    method, clock = timed([1.0])
    method.finish_seconds = lambda measurement: 0.5 + 0.5 * len(measurement.iterations)
    result = Runner(method, seed=0, budget=Budget(seconds=12.0), clock=clock).run()
    assert (result.passes, result.stopped_by) == (8, "seconds")  # 8 + 4.5 s; after 7, an eighth and what 7 need fit


@pytest.mark.parametrize(("spent", "passes"), [(7.0, 5), (7.5, 4), (50.0, 1)])
def test_preparation_is_a_part_of_the_time(timed, spent, passes):
    method, clock = timed([1.0])
    result = Runner(method, seed=0, budget=Budget(seconds=12.0), spent=spent, clock=clock).run()
    assert (result.passes, result.stopped_by) == (passes, "seconds")
    assert result.elapsed == pytest.approx(spent + passes)
    assert result.measurement.counters["seconds"] == pytest.approx(spent + passes)


@pytest.mark.parametrize(
    ("budget", "spent", "limits"),
    [
        (Budget(seconds=12.0), 2.0, (12.0, None, None)),  # by the clock, decisions would differ from run to run
        (Budget(seconds=12.0), 50.0, (12.0, None, None)),
        (Budget(samples=7, error=0.1), 2.0, (None, 7, 0.1)),
    ],
)
def test_a_method_that_asks_is_told_the_budget(timed, budget, spent, limits):
    method, clock = timed([1.0])
    told = []
    method.plan = lambda *ahead: told.append((*ahead, clock()))
    start = method.measured(0, 0)
    begin = clock()
    Runner(method, seed=0, budget=budget, spent=spent, clock=clock).run()
    Runner(method, seed=0, budget=Budget(iterations=3), start=start, clock=clock).run()
    assert told[0] == (*limits, begin)  # before the first pass
    assert told[1][:3] == (None, 3, None)  # all passes: a continued run decides as a whole one


def test_first_limit_reached_stops(timed):
    method, clock = timed([1.0])
    result = Runner(method, seed=0, budget=Budget(seconds=5.0, samples=3), clock=clock).run()
    assert (result.passes, result.stopped_by) == (3, "samples")
    method, clock = timed([1.0])
    result = Runner(method, seed=0, budget=Budget(seconds=5.0, samples=30), clock=clock).run()
    assert (result.passes, result.stopped_by) == (5, "seconds")


def test_error_budget_stops_at_the_noise_that_was_asked_for(noise):
    result = Runner(noise, seed=1, budget=Budget(error=0.01, iterations=2000)).run()
    assert result.stopped_by == "error"
    assert result.measurement.relative_error() <= 0.01
    # Variance of a pass is 1/2, of the mean 1/(2n), relative to a mean of 1: about 50 passes, and no twice that.
    assert 30 < result.passes < 80


def test_error_budget_is_not_believed_before_sixteen_passes(noise):
    result = Runner(noise, seed=1, budget=Budget(error=1e9)).run()
    assert (result.passes, result.stopped_by) == (LEAST_PASSES_FOR_ERROR, "error")
    assert Runner(noise, seed=1, budget=Budget(error=1e9, iterations=3)).run().stopped_by == "samples"


def test_passes_that_found_no_light_do_not_end_a_run(noise):
    """As ``path`` on caustics: the first passes agree on black, which is no picture without noise."""
    measured = noise.measured

    def late(iteration, seed):
        made = measured(iteration, seed)
        if iteration < 8:
            made.sums["image"] *= 0
            made.squares["image"] *= 0
        return made

    noise.measured = late
    result = Runner(noise, seed=1, budget=Budget(error=0.02, iterations=2000)).run()
    assert result.passes > LEAST_PASSES_FOR_ERROR
    assert result.measurement.relative_error() <= 0.02


def test_accumulation_is_the_sum_of_the_passes(noise):
    result = Runner(noise, seed=3, budget=Budget(iterations=5)).run()
    expected = noise.measured(0, 3)
    for iteration in range(1, 5):
        expected += noise.measured(iteration, 3)
    assert np.array_equal(result.measurement.sums["image"], expected.sums["image"])
    assert result.result.image.dtype == np.float32
    assert result.measurement.counters["rays"] == 500.0


def test_memory_does_not_grow_with_the_passes(noise):
    noise.shape = (64, 64, 3)
    arrays = []
    runner = Runner(noise, seed=0, budget=Budget(iterations=50))
    runner.on_progress = lambda progress: arrays.append(id(runner.interrupted().measurement.sums["image"]))
    runner.run()
    assert len(set(arrays)) == 1  # added in place


def test_progress_speaks_of_time_rate_noise_and_share(timed):
    method, clock = timed([2.0])
    seen = []
    Runner(method, seed=0, budget=Budget(seconds=100.0, samples=5), on_progress=seen.append, clock=clock).run()
    assert [p.passes for p in seen] == [1, 2, 3, 4, 5]
    assert [p.eta for p in seen] == pytest.approx([8.0, 6.0, 4.0, 2.0, 0.0])
    assert [p.fraction for p in seen] == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0])
    assert seen[0].error is None
    assert seen[-1].error > 0
    assert seen[-1].rays_per_second == pytest.approx(50.0)
    assert "pass 5, 5 spp, 10.0s" in str(seen[-1])


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OutputError("cannot write 'x': no space; free some"), "cannot write 'x': no space; free some"),
        (OSError(28, "No space left on device"), "OSError: [Errno 28] No space left on device"),
        (MemoryError(), "MemoryError"),
        (RuntimeError("a fault\n  of the writer"), "RuntimeError: a fault of the writer"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_saves_come_in_time_and_their_failure_costs_nothing(timed, caplog, error, words):
    method, clock = timed([1.0])
    saves = []

    def save(run):
        saves.append((run.passes, run.stopped_by))
        raise error

    result = Runner(method, seed=0, budget=Budget(iterations=9), on_save=save, save_every=3.0, clock=clock).run()
    assert saves == [(3, "running"), (6, "running"), (9, "running")]
    assert result.passes == 9
    assert caplog.messages == [f"an intermediate save failed, the run continues: {words}"] * 3


def test_slow_saves_become_rare(timed):
    method, clock = timed([1.0])
    saves = []

    def save(run):
        saves.append(run.passes)
        clock.now += 2.0

    Runner(method, seed=0, budget=Budget(iterations=60), on_save=save, save_every=1.0, clock=clock).run()
    assert saves == [1, 21, 41]  # two seconds of saving for twenty of rendering


def test_saves_at_given_times_follow_the_pass_that_reaches_them(timed):
    method, clock = timed([2.5, 1.0])
    saves = []
    budget = Budget(seconds=10.0)
    runner = Runner(
        method,
        seed=0,
        budget=budget,
        on_save=lambda run: saves.append((run.elapsed, run.save_times)),
        save_at=[1.0, 2.0, 5.0, 9.8, 11.0],
        clock=clock,
    )
    result = runner.run()
    assert saves == [(2.5, (1.0, 2.0)), (5.5, (5.0,))]
    # No pass was begun that would have ended at 10.5; the save beyond the budget is not due.
    assert (result.elapsed, result.stopped_by, result.save_times) == (9.5, "seconds", (9.8,))


def test_a_save_in_time_stands_for_a_periodic_one_too(timed):
    method, clock = timed([1.0])
    saves = []

    def save(run):
        saves.append((run.passes, run.save_times))

    Runner(method, seed=0, budget=Budget(iterations=8), on_save=save, save_every=3, save_at=[4], clock=clock).run()
    assert saves == [(3, ()), (4, (4,)), (7, ())]


def test_times_whose_save_failed_come_with_the_next_save(timed):
    """Or with the end, if no other save succeeds."""
    for failing, expected, left in ((1, [(2, (2,)), (4, (2, 4))], ()), (9, [(2, (2,)), (4, (2, 4))], (2, 4))):
        method, clock = timed([1.0])
        tried = []

        def save(run, tried=tried, failing=failing):
            tried.append((run.passes, run.save_times))
            if len(tried) <= failing:
                raise OutputError("the disk is full")

        runner = Runner(method, seed=0, budget=Budget(iterations=6), on_save=save, save_at=[2, 4, 9], clock=clock)
        assert runner.run().save_times == left
        assert tried == expected


@pytest.mark.parametrize("save_at", [[0.0], [2.0, 1.0], [1.0, 1.0], [float("nan")], [float("inf")], ["1"]])
def test_times_of_saves_are_checked(noise, save_at):
    with pytest.raises(OptionError, match="times of saves"):
        Runner(noise, seed=0, budget=Budget(iterations=1), on_save=print, save_at=save_at)


def test_a_save_that_must_be_made(noise):
    """After the passes that ask for it; if it fails, so does the run, with what was done."""
    passes = []
    options = {"seed": 0, "budget": Budget(iterations=7), "save_if": lambda measured: len(measured.iterations) % 3 == 0}
    Runner(noise, on_save=lambda run: passes.append(run.passes), **options).run()
    assert passes == [3, 6]

    def fail(run):
        raise OutputError("the disk is full")

    with pytest.raises(RunError, match=r"the disk is full \(after 3 passes") as caught:
        Runner(noise, on_save=fail, **options).run()
    assert caught.value.run.passes == 3


def test_the_end_is_estimated_once_a_pass(noise, monkeypatch):
    asked = []
    monkeypatch.setattr(noise, "finish_seconds", lambda measured: asked.append(len(measured.iterations)) or 0, False)
    Runner(noise, seed=0, budget=Budget(iterations=5, seconds=60)).run()
    assert asked == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("save_every", [0.0, -1.0, float("nan")])
def test_time_between_saves_is_checked(noise, save_every):
    with pytest.raises(OptionError, match="time between saves"):
        Runner(noise, seed=0, budget=Budget(iterations=1), on_save=print, save_every=save_every)


def test_cancel_stops_at_the_next_pass(noise):
    cancel = threading.Event()
    noise.before_pass = lambda iteration: cancel.set() if iteration == 2 else None
    result = Runner(noise, seed=0, budget=Budget(), cancel=cancel).run()
    assert (result.passes, result.stopped_by) == (3, "cancel")


def test_cancel_before_the_first_pass_leaves_no_picture(noise):
    cancel = threading.Event()
    cancel.set()
    with pytest.raises(Cancelled, match="there is no picture"):
        Runner(noise, seed=0, budget=Budget(iterations=3), cancel=cancel).run()


def test_a_failing_pass_loses_no_work(noise):
    def fail(iteration):
        if iteration == 3:
            raise RuntimeError("device\n   lost")

    noise.before_pass = fail
    with pytest.raises(RunError, match=r"RuntimeError: device lost \(after 3 passes, which are kept\)") as caught:
        Runner(noise, seed=0, budget=Budget(iterations=10)).run()
    assert isinstance(caught.value.__cause__, RuntimeError)
    assert caught.value.run.passes == 3
    assert caught.value.run.stopped_by == "failure"
    assert np.array_equal(
        caught.value.run.measurement.sums["image"],
        (noise.measured(0, 0) + noise.measured(1, 0) + noise.measured(2, 0)).sums["image"],
    )


def test_a_failing_first_pass_raises_what_it_raised(noise):
    noise.before_pass = lambda iteration: 1 / 0
    with pytest.raises(ZeroDivisionError):
        Runner(noise, seed=0, budget=Budget(iterations=10)).run()


def test_ctrl_c_in_a_pass_keeps_those_before_it(noise):
    def interrupt(iteration):
        if iteration == 2:
            raise KeyboardInterrupt

    noise.before_pass = interrupt
    runner = Runner(noise, seed=0, budget=Budget(iterations=10))
    with pytest.raises(KeyboardInterrupt):
        runner.run()
    assert runner.interrupted().passes == 2


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_measurement_and_state_are_of_the_same_passes(noise, error):
    """A pass fails after it has begun to change what it carries on."""
    carried = []

    def learn(iteration, seed, state):
        carried.append(iteration)
        if iteration == 3:
            raise error("on purpose")
        return Pass(noise.measured(iteration, seed), {"passes": state.get("passes", 0) + 1})

    noise.step = learn
    runner = Runner(noise, seed=0, budget=Budget(iterations=6))
    with pytest.raises((RunError, KeyboardInterrupt)):
        runner.run()
    left = runner.interrupted()
    assert (left.passes, left.state, carried) == (3, {"passes": 3}, [0, 1, 2, 3])


def test_a_run_that_carries_on_wants_its_state(noise):
    noise.carries_on = True
    with pytest.raises(OptionError, match="give the state"):
        Runner(noise, seed=0, budget=Budget(iterations=6), start=noise.measured(0, 0))


def test_start_is_continued_and_counts(noise):
    first = Runner(noise, seed=7, budget=Budget(samples=4)).run()
    second = Runner(noise, seed=7, budget=Budget(samples=10), start=first.measurement).run()
    whole = Runner(noise, seed=7, budget=Budget(samples=10)).run()
    assert np.array_equal(second.measurement.sums["image"], whole.measurement.sums["image"])
    assert second.measurement.iterations == whole.measurement.iterations


def test_a_reached_total_does_no_further_pass(noise):
    first = Runner(noise, seed=7, budget=Budget(samples=4)).run()
    noise.before_pass = lambda iteration: pytest.fail("a pass was made")
    assert Runner(noise, seed=7, budget=Budget(samples=4), start=first.measurement).run().passes == 4

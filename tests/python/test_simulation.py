import logging
import threading
import time

import numpy as np
import pytest

import fnopt

SMALL = fnopt.Scene().replace(grid=16)


def simulation(scene=SMALL, solver="spectral", **options):
    return fnopt.Simulation(scene, solver, device="cpu", **options)


def run(sim, frames):
    for _ in range(frames):
        sim.step()
    return sim.positions


def test_arrays_are_in_metres_and_keep_what_they_had():
    sim = simulation()
    start = sim.positions
    assert start.shape == (1, 256, 3) and start.dtype == np.float32
    # Hanging from two corners, 0.9 m apart, y up.
    held = start[0, sim.handles[0]]
    assert np.allclose(held, [[0, 0.5, 0.45], [0, 0.5, -0.45]], atol=1e-6)
    assert -0.6 < start[0, :, 1].min() < -0.3
    before = start.copy()
    run(sim, 40)
    assert np.array_equal(start, before) and not np.array_equal(sim.positions, before)
    assert sim.frame == 40 and sim.time == pytest.approx(40 / 60) and sim.frames == 391
    assert sim.velocities.shape == (1, 256, 3) and np.abs(sim.velocities).max() < 5
    assert sim.faces.shape == (2 * 15 * 15, 3) and sim.faces.max() == 255
    assert sim.uv.shape == (256, 2) and sim.particle_count == 256 and sim.grid == (16, 16)
    assert sim.device.startswith("cpu")


def test_statistics_are_those_of_the_last_frame():
    sim = simulation("sphere", cloths=2)
    assert sim.stats == []
    run(sim, 3)
    first, second = sim.stats
    assert first["frame"] == 3 and {"energy", "gradient_last", "stretch_largest", "bodies"} <= first.keys()
    assert len(first["bodies"]) == 2 and first["energy_total"] == second["energy_total"]


def test_a_batch_of_scenes_has_the_bits_of_each_alone():
    scenes = [SMALL, SMALL.replace(material="paper"), SMALL.replace(wind={"velocity": [2, 0, 0]})]
    together = run(simulation(scenes), 12)
    assert together.shape == (3, 256, 3)
    for b, scene in enumerate(scenes):
        assert np.array_equal(together[b], run(simulation(scene), 12)[0])
    copies = run(simulation(cloths=2), 12)
    assert np.array_equal(copies[0], together[0]) and np.array_equal(copies[1], together[0])


def test_events_come_in_batches_too():
    def released(frame):
        return SMALL.replace(motion="none", frames=30, events=[{"frame": frame, "release": [[0, 0]]}])

    sim = simulation([released(5), released(8)])
    held = []
    for _ in range(9):
        sim.step()
        held.append([len(handles) for handles in sim.handles])
    assert held[3:] == [[2, 2], [1, 2], [1, 2], [1, 2], [1, 1], [1, 1]]
    alone = run(simulation(released(5)), 9)
    assert np.array_equal(sim.positions[0], alone[0])
    sim.reset()
    assert sim.frame == 0 and [len(handles) for handles in sim.handles] == [2, 2]
    assert np.array_equal(run(sim, 9)[0], alone[0])


def test_a_host_leads_bodies():
    ball = {"shape": "sphere", "radius_m": 0.1, "position_m": [0.4, 0, 0]}
    sim = simulation(SMALL.replace(motion="none", bodies=[ball]), cloths=2)
    before = sim.bodies
    assert before.shape == (2, 7) and np.allclose(before[0], [0.4, 0, 0, 0, 0, 0, 1])
    for _ in range(30):
        control = sim.control()
        control.bodies = sim.bodies
        control.bodies[1, 0] -= 0.02
        sim.step(control)
    assert np.allclose(sim.bodies[:, 0], [0.4, -0.2]) and np.array_equal(before[0], sim.bodies[0])
    # The ball has pushed the sheet of the second cloth aside, and nothing of it is inside.
    moved = np.abs(sim.positions[1] - sim.positions[0]).max()
    distance = np.linalg.norm(sim.positions[1] - sim.bodies[1, :3], axis=1).min()
    assert moved > 0.05 and distance > 0.099, (moved, distance)
    for bodies, text in [(np.zeros((2, 3)), "bodies: expected an array"), (before[:1], "bodies: expected 2")]:
        with pytest.raises(ValueError, match=text):
            sim.step(fnopt.Control(bodies=bodies))


def test_the_control_of_the_scene_is_what_a_step_without_one_takes():
    one, other = simulation(), simulation()
    for _ in range(40):
        one.step()
        other.step(other.control())
    assert np.abs(one.positions - other.positions).max() < 1e-5


def test_handles_go_where_a_control_says_and_wind_blows():
    sim = simulation(SMALL.replace(motion="none"))
    targets = sim.control().handles
    for k in range(10):
        sim.step(fnopt.Control(handles=targets + [0, 0.01 * (k + 1), 0]))
    held = sim.positions[0, sim.handles[0]]
    assert np.allclose(held, targets + [0, 0.1, 0], atol=1e-5)

    def blown(control):
        sim = simulation(SMALL.replace(motion="none"))
        for _ in range(30):
            sim.step(control)
        return sim.positions[0, :, 0].mean()

    still = blown(None)
    assert blown(fnopt.Control(wind=[3, 0, 0])) > still + 0.05
    assert blown(fnopt.Control(accelerations=[5, 0, 0])) > still + 0.05
    each = np.zeros((1, 256, 3))
    each[..., 0] = 5
    assert blown(fnopt.Control(accelerations=each)) == blown(fnopt.Control(accelerations=[5, 0, 0]))


def test_an_acceleration_against_gravity_leaves_a_free_cloth_where_it_is():
    sim = simulation(SMALL.replace(handles=[], motion="none", start="flat", wind={"density": 0}))
    start = sim.positions
    for _ in range(10):
        sim.step(fnopt.Control(accelerations=[0, 9.8, 0], handles=[]))
    assert np.abs(sim.positions - start).max() < 1e-4
    sim.step()
    # A frame of free fall: v = g dt.
    assert sim.velocities[0, :, 1].mean() == pytest.approx(-9.8 / 60, rel=1e-3)


def test_states_are_set_and_frames_counted_on():
    sim = simulation(cloths=2)
    run(sim, 20)
    moved = sim.positions + np.float32([0.5, 0, 0])
    sim.set_state(moved, sim.velocities)
    assert sim.frame == 20 and np.allclose(sim.positions, moved, atol=1e-6)
    other = sim.positions[1]
    sim.set_state(moved[0] + 1, cloth=0)
    assert np.allclose(sim.positions[0], moved[0] + 1, atol=1e-6) and np.array_equal(sim.positions[1], other)
    assert np.abs(sim.velocities[0]).max() == 0 < np.abs(sim.velocities[1]).max()
    sim.step()
    assert sim.frame == 21


def test_a_snapshot_goes_on_to_the_same_bits():
    scene = SMALL.replace(events=[{"frame": 15, "release": [[0, 0]]}, {"frame": 20, "grab": [[0, 8]]}])
    sim = simulation(scene)
    run(sim, 22)
    snapshot = sim.snapshot()
    expected = run(sim, 10)
    sim.reset()
    sim.restore(snapshot)
    assert sim.frame == 22 and np.array_equal(run(sim, 10), expected)
    fresh = simulation(scene)
    fresh.restore(snapshot)
    assert np.array_equal(run(fresh, 10), expected)
    with pytest.raises(ValueError, match="snapshot: state: expected 1536 numbers"):
        simulation(scene, cloths=2).restore(snapshot)
    # Of another solver, or of other handles: nothing changes.
    for other in (simulation(scene, "fnopt"), simulation(SMALL.replace(motion="none", handles=[[0, 0]]))):
        expected = run(other, 5)
        other.reset()
        run(other, 4)
        with pytest.raises(ValueError):
            other.restore(snapshot)
        assert other.frame == 4 and np.array_equal(run(other, 1), expected)


def test_what_is_wrong_is_named():
    sim = simulation()
    wrong = [
        (lambda: sim.step(fnopt.Control(handles=[[0, 0, 0]])), "control: handles: expected 2, one for each handle of all cloths together, found 1"),
        (lambda: sim.step(fnopt.Control(handles=[[0, np.nan, 0], [0, 0, 0]])), r"handles\[0\]: expected finite"),
        (lambda: sim.step(fnopt.Control(wind=[1, 2])), "wind: expected an array"),
        (lambda: sim.step(fnopt.Control(wind=[[1, 2, 3]] * 2)), r"wind: expected an array \[1, 3\]"),
        (lambda: sim.step(fnopt.Control(handles="ab")), "handles: expected an array of numbers"),
        (lambda: sim.set_state(np.zeros((9, 3))), "positions: expected an array"),
        (lambda: sim.set_state(np.zeros((256, 3)), cloth=1), "state: cloth: expected 0 to 0, found 1"),
        (lambda: sim.set_state(np.full((256, 3), np.inf)), "positions of particle 0: expected finite"),
        (lambda: simulation(solver="spektral"), "did you mean spectral"),
        (lambda: fnopt.Simulation(SMALL, device="cuda"), "unknown device 'cuda' .did you mean auto, cpu, gpu"),
        (lambda: simulation(precision="f8"), "unknown precision 'f8'"),
        (lambda: simulation(iterations=0), "iterations: expected 1 to 100000"),
        (lambda: simulation(cloths=0), "cloths: expected at least one"),
        (lambda: simulation([]), "cloths: expected at least one"),
        (lambda: simulation([SMALL, SMALL.replace(grid=17)]), "cloth 1: expected a 16x16 grid"),
        (lambda: simulation(adapter="x"), "expected none with the device cpu"),
        (lambda: simulation(checkpoint="x"), "expected none with the solver spectral"),
        (lambda: simulation(precision="f16"), "expected f32 on cpu"),
    ]
    for make, text in wrong:
        with pytest.raises(ValueError, match=text):
            make()
    assert sim.frame == 0
    with pytest.raises(RuntimeError, match="no adapter named 'no such thing'"):
        fnopt.Simulation(SMALL, adapter="no such thing")
    with pytest.raises(OverflowError):
        simulation(iterations=-1)


def test_a_cloth_that_explodes_is_an_error_and_can_be_started_again():
    sim = simulation(solver="gd", iterations=1)
    sim.set_state(sim.positions * np.float32(1e18))
    with pytest.raises(fnopt.NonFiniteError, match="cloth 0 became non-finite") as error:
        run(sim, 50)
    assert error.value.cloth == 0 and error.value.frame == sim.frame
    assert not np.isfinite(sim.positions).all()
    sim.reset()
    assert np.isfinite(run(sim, 1)).all()


def test_the_others_of_a_batch_go_on_when_one_explodes():
    sim, alone = simulation(solver="gd", cloths=2), simulation(solver="gd")
    start = sim.positions[0]
    run(sim, 3)
    sim.set_state(start * np.float32(1e18), cloth=0)
    with pytest.raises(fnopt.NonFiniteError, match="cloth 0"):
        run(sim, 50)
    frames = sim.frame
    sim.set_state(start, cloth=0)
    assert np.isfinite(run(sim, 4)).all() and sim.frame == frames + 4
    assert np.array_equal(sim.positions[1], run(alone, frames + 4)[0])


def test_other_threads_run_while_frames_are_computed():
    sim = fnopt.Simulation(fnopt.Scene(), "spectral", 2000, device="cpu")
    done, ticks = threading.Event(), []

    def tick():
        while not done.is_set():
            ticks.append(time.perf_counter())
            time.sleep(0.001)

    thread = threading.Thread(target=tick)
    thread.start()
    begun = time.perf_counter()
    run(sim, 3)
    took = time.perf_counter() - begun
    done.set()
    thread.join()
    within = [t for t in ticks if begun < t < begun + took]
    assert len(within) > 20 and np.diff(within).max() < 0.5 * took


def test_warnings_go_to_the_logger(caplog):
    with caplog.at_level(logging.WARNING, logger="fnopt"):
        simulation(SMALL.replace(start={"vertices": np.zeros((256, 3)) + [0, 0, 1.5], "grid": [16, 16]}))
    assert "edges along the height" in caplog.text


def test_solvers_and_adapters_are_listed():
    solvers = fnopt.solvers()
    assert solvers["spectral"] == {"iterations": 20, "devices": ["cpu", "gpu"]}
    assert solvers["newton"] == {"iterations": None, "devices": ["cpu"]}
    for name in solvers:
        simulation(solver=name)
    # The library knows no others.
    with pytest.raises(ValueError) as error:
        simulation(solver="no such solver")
    hint = str(error.value).split("(did you mean ")[1].rstrip(")")
    assert sorted(hint.replace("? others: ", ", ").split(", ")) == sorted(solvers)
    assert all({"name", "kind", "backend", "driver", "unusable"} == set(of) for of in fnopt.adapters())


def test_a_gpu_computes_the_same_to_rounding():
    if not fnopt.adapters():
        pytest.skip("no adapter")
    on_gpu = fnopt.Simulation(SMALL, "spectral", 5, device="gpu")
    assert not on_gpu.device.startswith("cpu")
    assert np.abs(run(on_gpu, 4) - run(simulation(iterations=5), 4)).max() < 1e-4

import json
import os
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pytest

import fnopt

SMALL = fnopt.Scene().replace(grid=16)


def rollout(scene=SMALL, **options):
    options = {"solver": "spectral", "device": "cpu", "progress": False, "frames": 20, **options}
    return fnopt.rollout(scene, **options)


@pytest.mark.parametrize(
    "scene, solver", [("curtain", "spectral"), ("pleats", "spectral"), ("twist", "spectral"), (None, "fnopt")]
)
def test_frames_and_report_are_those_of_the_command(command, tmp_path, scene, solver):
    options = ["--solver", solver, "--frames", "40", "--device", "cpu", "--no-pictures", "--out", str(tmp_path)]
    subprocess.run([command, "rollout", *([scene] if scene else []), *options], check=True, capture_output=True)
    found = rollout(scene or fnopt.Scene(), solver=solver, frames=40)
    with np.load(tmp_path / "rollout.npz") as truth:
        assert np.array_equal(found.positions, truth["vertices_seq"])
        assert np.array_equal(found.velocities, truth["velocities_seq"])
        assert np.array_equal(found.faces, truth["faces"]) and np.array_equal(found.uv, truth["vertices_uv"])
        assert found.fps == truth["fps"]
    # Frame by frame, too.
    sim = fnopt.Simulation(scene or fnopt.Scene(), solver, device="cpu")
    for frame in range(1, 40):
        sim.step()
        assert np.array_equal(sim.positions[0], found.positions[frame])

    def timeless(report):
        report = {key: value for key, value in report.items() if key not in ("files", "intersections", "against")}
        # What its files are like is the command's own.
        settings = {key: value for key, value in report["settings"].items() if key not in ("every", "fps", "half")}
        return {
            **report,
            "settings": settings,
            "ms_per_frame": 0,
            "per_frame": [{**frame, "ms": 0} for frame in report["per_frame"]],
        }

    assert timeless(found.report) == timeless(json.loads((tmp_path / "report.json").read_text()))


def test_a_rollout_has_its_frames_and_a_report():
    found = rollout()
    assert found.positions.shape == found.velocities.shape == (20, 256, 3)
    assert found.positions.dtype == np.float32 and len(found) == 20
    assert (found.status, found.sound, found.grid, found.fps) == ("done", True, (16, 16), 60)
    assert found.report["settings"]["solver"] == "spectral" and len(found.report["per_frame"]) == 19


def test_arrays_are_views_that_outlive_the_rollout():
    positions = rollout().positions
    assert positions.base is not None
    with pytest.raises(ValueError, match="read-only"):
        positions[0] = 0
    with pytest.raises(ValueError):
        positions.setflags(write=True)
    assert np.array_equal(positions, rollout().positions)


@pytest.mark.parametrize("ending", ["npz", "npy", "obj", "ply", "pc2", "mdd", "usda", "glb"])
def test_every_format_is_written(tmp_path, ending):
    found = rollout(frames=3)
    path = found.save(tmp_path / "new" / f"a.{ending}")
    assert found.save(str(tmp_path / "b"), ending).name == path.name.replace("a", "b", 1)
    if ending in ("obj", "ply"):
        assert [p.name for p in sorted(path.iterdir())] == [f"0000{f}.{ending}" for f in range(3)]
    else:
        assert path == tmp_path / "new" / f"a.{ending}" and path.stat().st_size > 3 * 256 * 12
    assert (tmp_path / "new" / "a.obj").exists() == (ending in ("pc2", "mdd"))
    if ending == "npz":
        with np.load(path) as read:
            assert np.array_equal(read["vertices_seq"], found.positions)


def test_files_know_which_axis_is_up_and_take_options(tmp_path):
    up = rollout(SMALL.replace(up="z"), frames=3)
    assert 'upAxis = "Z"' in up.save(tmp_path / "up.usda").read_text()
    found = rollout(frames=3)
    text = found.save(tmp_path / "a.usda", fps=25, start_frame=101).read_text()
    assert 'upAxis = "Y"' in text and "startTimeCode = 101" in text and "timeCodesPerSecond = 25" in text
    small = found.save(tmp_path / "a.npz", half=True, compress=True)
    with np.load(small) as read:
        assert read["vertices_seq"].dtype == np.float16
    assert small.stat().st_size < found.save(tmp_path / "b.npz").stat().st_size / 2
    with pytest.raises(ValueError, match="start_frame: expected pc2 or usda or obj or ply, which it is about"):
        found.save(tmp_path / "c.npz", start_frame=1)
    with pytest.raises(ValueError, match="fps: expected a number above 0"):
        found.save(tmp_path / "a.usda", fps=0)


def test_wrong_names_of_files_are_refused(tmp_path):
    found = rollout(frames=2)
    for path, text in [("a.npzz", "did you mean npz"), ("a", "a file name that ends in a format")]:
        with pytest.raises(ValueError, match=text):
            found.save(tmp_path / path)
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="cannot create the folder"):
        found.save(tmp_path / "file" / "a.npz")


def test_the_frames_before_an_explosion_are_kept():
    wild = SMALL.replace(material={"stretch": 1e9, "shear": 1e9, "bend": 1e9}, motion="none", start="flat")
    with pytest.raises(fnopt.NonFiniteError) as error:
        rollout(wild, solver="gd", frames=None)
    kept = error.value.rollout
    assert len(kept) == error.value.frame and kept.status == "non-finite" and not kept.sound
    assert np.isfinite(kept.positions).all()


def test_ctrl_c_keeps_what_is_done():
    program = """
        import fnopt, os, signal, threading
        # Started in the background, a shell has it ignored.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        threading.Timer(1, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
        try:
            fnopt.rollout(fnopt.Scene(), "spectral", frames=100000, device="cpu", progress=False)
        except KeyboardInterrupt as stop:
            print(len(stop.rollout), stop.rollout.status, stop.rollout.positions.shape[0])
    """
    run = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    frames, status, positions = run.stdout.split()
    assert status == "interrupted" and frames == positions and 1 < int(frames) < 100000


def test_a_progress_bar_reaches_the_end(capsys):
    pytest.importorskip("tqdm")
    rollout(progress=True)
    assert "19/19" in capsys.readouterr().err
    rollout(progress=False)
    assert capsys.readouterr().err == ""


def test_scenes_of_several_kinds_are_taken(tmp_path):
    (tmp_path / "scene.json").write_text('{"grid": [16, 16]}')
    frames = [rollout(scene).positions for scene in (SMALL, {"grid": [16, 16]}, tmp_path / "scene.json")]
    assert np.array_equal(frames[0], frames[1]) and np.array_equal(frames[0], frames[2])

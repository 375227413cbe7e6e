import pickle

import numpy as np
import pytest

import fnopt


def test_the_default_scene_is_that_of_an_empty_dict():
    scene = fnopt.Scene()
    assert scene == fnopt.Scene.from_dict({})
    assert scene.grid == (32, 32) and scene.frames is None and scene.frame_dt == pytest.approx(1 / 60)


def test_every_scene_has_a_name_and_goes_to_a_dict_and_back():
    names = fnopt.Scene.names()
    assert "sphere" in names and all(names.values())
    for name in names:
        scene = fnopt.Scene.from_file(name)
        assert fnopt.Scene.from_dict(scene.to_dict()) == scene


def test_paths_of_a_dict_are_those_of_its_folder(tmp_path):
    moves = np.zeros((5, 2, 3))
    moves[:, 0] = [0, 0.5, 0.45]
    moves[:, 1] = [0, 0.5, -0.45]
    np.save(tmp_path / "moves.npy", moves)
    scene = fnopt.Scene.from_dict({"motion": "moves.npy"}, folder=tmp_path)
    assert fnopt.Simulation(scene, "gd", device="cpu").frames == 5
    # Arrays and paths stand for lists and text.
    given = fnopt.Scene.from_dict({"motion": tmp_path / "moves.npy", "handles": np.array([[31, 0], [0, 0]])})
    assert fnopt.Simulation(given, "gd", device="cpu").frames == 5


def test_files_come_before_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sphere").write_text('{"grid": [9, 8]}')
    assert fnopt.Scene.from_file("sphere").grid == (9, 8)
    assert fnopt.Scene.from_file("sphere", grid=16, frames=7).grid == (16, 16)


def test_scenes_go_to_other_processes():
    scene = fnopt.Scene.from_file("table", grid=20)
    assert pickle.loads(pickle.dumps(scene)) == scene


def test_fields_are_replaced_in_a_copy():
    scene = fnopt.Scene.from_file("twist")
    other = scene.replace(grid=(24, 20), frames=10, wind={"velocity": [0, 0, 3]}, mass_kg=0.3)
    assert (other.grid, other.frames, scene.grid != other.grid) == ((24, 20), 10, True)
    fields = other.to_dict()
    assert fields["wind"]["velocity"] == [0, 0, 3] and fields["mass_kg"] == 0.3
    # Fewer frames are a part of the scene.
    assert all(event["frame"] < 10 for event in fields["events"])
    assert fields["bodies"] == scene.to_dict()["bodies"]


@pytest.mark.parametrize(
    "make, kind, text",
    [
        (lambda: fnopt.Scene.from_file("spere"), ValueError, "did you mean sphere"),
        (lambda: fnopt.Scene.from_file("no/such.json"), FileNotFoundError, "no/such.json: cannot read"),
        (lambda: fnopt.Scene.from_dict({"grd": 32}), ValueError, "unknown field 'grd' (did you mean grid"),
        (lambda: fnopt.Scene.from_dict({"side_m": -1}), ValueError, "side_m: expected a finite number above 0"),
        (lambda: fnopt.Scene.from_dict({"side_m": float("nan")}), ValueError, "Scene.from_dict"),
        (lambda: fnopt.Scene().replace(graviti=3), ValueError, "did you mean gravity"),
        (lambda: fnopt.Scene().replace(grid=3), ValueError, "expected 8 to 4096"),
        (lambda: fnopt.Scene().replace(frames=0), ValueError, "frames: expected 1 or more"),
        (lambda: fnopt.Scene.from_dict({"motion": object()}), TypeError, "object"),
        (lambda: fnopt.rollout(3), TypeError, "expected a Scene, a dict, a path or a name"),
    ],
)
def test_errors_have_the_texts_of_the_library(make, kind, text):
    with pytest.raises(kind) as error:
        make()
    assert text in str(error.value)

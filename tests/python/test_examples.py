import importlib.util
import json

import numpy as np
import pytest
from conftest import ROOT


def example(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "examples" / "python" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_data_set_is_the_same_again_and_goes_on_where_it_ended(tmp_path, capsys):
    dataset = example("dataset")
    small = ["--frames", "12", "--grid", "10", "--device", "cpu", "--out"]
    dataset.main([*small, str(tmp_path / "a"), "--count", "2"])
    first = np.load(tmp_path / "a" / "00001.npz")["vertices_seq"]
    dataset.main([*small, str(tmp_path / "a"), "--count", "3"])
    assert "3 samples" in capsys.readouterr().out.splitlines()[-1]
    assert len(list((tmp_path / "a").glob("*.npz"))) == 3 and not list((tmp_path / "a").glob("*.part"))
    (tmp_path / "a" / "00001.json").unlink()
    dataset.main([*small, str(tmp_path / "a"), "--count", "3"])
    assert "1 of them new" in capsys.readouterr().out
    assert np.array_equal(np.load(tmp_path / "a" / "00001.npz")["vertices_seq"], first)
    assert first.shape == (12, 100, 3)
    record = json.loads((tmp_path / "a" / "00001.json").read_text())
    assert record["sound"] and record["frames"] == 12 and record["scene"]["grid"] == [10, 10]
    # Other seeds are other samples, whose corners move otherwise.
    other = dataset.random_scene(1, 1, 10, 12).to_dict()
    assert other["motion"] != record["scene"]["motion"]


def test_the_comparison_finds_the_springs_further_from_the_truth(capsys):
    measures = example("compare").main(["--grid", "10", "--frames", "25", "--solvers", "spectral"])
    mean = {name: of["distance_mean"].mean() for name, of in measures.items()}
    assert mean["spectral"] < 1e-3 and mean["spectral"] < mean["springs"] < 0.1
    assert "springs" in capsys.readouterr().out


def test_springs_at_rest_pull_with_their_weight_alone():
    compare = example("compare")
    import fnopt

    scene = fnopt.Scene().replace(grid=10, start="flat")
    flat = fnopt.Simulation(scene, "gd", device="cpu").positions[0]
    springs = compare.Springs(scene, flat, [0])
    assert springs.forces().sum(0) == pytest.approx(springs.mass.sum() * springs.gravity, abs=1e-5)
    assert springs.mass.sum() == pytest.approx(0.187, rel=1e-12)

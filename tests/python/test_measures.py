import numpy as np
import pytest

import fnopt

SMALL = fnopt.Scene().replace(grid=16)


def test_distances_are_those_of_numpy():
    random = np.random.default_rng(7)
    found, truth = random.normal(size=(2, 5, 40, 3))
    measures = fnopt.compare(found, truth)
    distances = np.linalg.norm(found - truth, axis=2)
    assert np.allclose(measures["distance_mean"], distances.mean(1), rtol=1e-12)
    assert np.allclose(measures["distance_largest"], distances.max(1), rtol=1e-12)
    relative = np.linalg.norm(found - truth, axis=(1, 2)) / np.linalg.norm(truth, axis=(1, 2))
    assert np.allclose(measures["relative_error"], relative, rtol=1e-12)
    with pytest.raises(ValueError, match="truth: expected frames and particles"):
        fnopt.compare(found, truth[:4])
    with pytest.raises(ValueError, match="frames, particles, 3"):
        fnopt.compare(found[0], truth[0])


def test_the_chamfer_distance_is_its_definition():
    random = np.random.default_rng(8)
    a, b = random.normal(size=(50, 3)), random.normal(size=(70, 3))
    squares = ((a[:, None] - b[None]) ** 2).sum(2)
    assert fnopt.chamfer(a, b) == pytest.approx(squares.min(1).mean() + squares.min(0).mean(), rel=1e-12)
    for wrong in ([], [[np.nan, 0, 0]]):
        with pytest.raises(ValueError, match="b: expected"):
            fnopt.chamfer(a, np.reshape(wrong, (-1, 3)))


def test_intersections_name_edge_and_triangle():
    flat = fnopt.Simulation(SMALL.replace(start="flat"), "gd", device="cpu")
    positions, faces = flat.positions[0], flat.faces
    assert fnopt.intersections(positions, 16).shape == (0, 3)
    # A corner is pushed through the sheet's middle.
    through = positions.copy()
    normal = np.cross(positions[1] - positions[0], positions[16] - positions[0])
    normal /= np.linalg.norm(normal)
    middle = positions[faces[len(faces) // 2]].mean(0)
    through[0] = middle + 0.01 * normal
    through[1] = through[16] = through[17] = middle - 0.01 * normal
    found = fnopt.intersections(through, (16, 16))
    assert len(found) > 0 and found[:, 2].max() < len(faces) and 0 in found[:, :2]
    with pytest.raises(ValueError, match="positions: expected an array"):
        fnopt.intersections(positions, 17)


def test_soundness_is_that_of_a_report_and_sees_what_is_wrong():
    found = fnopt.rollout(SMALL, "spectral", frames=45, device="cpu", progress=False)
    judged = fnopt.soundness(SMALL, found.positions, found.velocities)
    assert judged["sound"] and judged["unsound"] == []
    assert judged["stretch_largest_free"] == pytest.approx(found.report["stretch_largest_free"], rel=1e-4)
    assert judged["gap_estimate"] < 1e-3
    # Without velocities, from the differences.
    assert fnopt.soundness(SMALL, found.positions)["sound"]
    torn = found.positions.copy()
    torn[30:, 8 * 16 + 8] += 1
    judged = fnopt.soundness(SMALL, torn)
    assert not judged["sound"] and "stretched" in judged["unsound"][0]
    # Frames that do not move while the handles do.
    frozen = np.repeat(found.positions[:1], 100, axis=0)
    falling = SMALL.replace(motion="none", handles=[], start="flat")
    assert fnopt.soundness(falling, frozen, np.zeros_like(frozen))["gap_estimate"] > 0.3

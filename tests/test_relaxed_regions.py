"""Labelling of regions and classes by convex relaxation: its energy, its bound, its bits."""

import os
import subprocess
import sys

import numpy as np
import pytest

from tspline import _core


def gradient(u, spacing):
    """Forward differences, 0 beyond the border; (d, shape)."""
    steps = []
    for axis, h in enumerate(spacing):
        last = np.take(u, [-1], axis=axis)
        steps.append(np.diff(u, axis=axis, append=last) / h)
    return np.array(steps)


def divergence(p, spacing):
    """Minus the adjoint of `gradient`."""
    total = np.zeros(p.shape[1:])
    for axis, h in enumerate(spacing):
        q = p[axis].copy()
        q[(slice(None),) * axis + (-1,)] = 0
        total += np.diff(q, axis=axis, prepend=0) / h
    return total


def energy(u, evidence, edges, spacing):
    length = np.sqrt((gradient(u, spacing) ** 2).sum(axis=0))
    return float((edges * length - evidence * u).sum())


def slow_minimum(evidence, edges, spacing, steps=6000):
    """The textbook's primal-dual method in double precision, and the bound that its dual proves."""
    size = np.sqrt(4 * sum(1 / h**2 for h in spacing))
    u = np.full(evidence.shape, 0.5)
    ahead, p = u, np.zeros((evidence.ndim, *evidence.shape))
    for _ in range(steps):
        p = p + gradient(ahead, spacing) / size
        p /= np.maximum(1, np.sqrt((p**2).sum(axis=0)) / np.maximum(edges, 1e-12))
        old = u
        u = np.clip(u + (divergence(p, spacing) + evidence) / size, 0, 1)
        ahead = 2 * u - old
    bound = -np.maximum(divergence(p, spacing) + evidence, 0).sum()
    return u, bound


def relax(evidence, edges, spacing, **options):
    return _core.relaxed_regions(
        np.ascontiguousarray(evidence, np.float32), np.ascontiguousarray(edges, np.float32), spacing, **options
    )


def classes(evidence, edges, spacing, **options):
    return _core.relaxed_classes(
        np.ascontiguousarray(evidence, np.float32), np.ascontiguousarray(edges, np.float32), spacing, **options
    )


@pytest.mark.parametrize(
    ("shape", "spacing"), [((26, 31), (1.0, 1.0)), ((25, 30), (2.0, 0.5)), ((11, 9, 13), (3.0, 1.0, 1.0))]
)
def test_the_minimum_of_the_definition_is_reached(shape, spacing):
    rng = np.random.default_rng(1)
    evidence = rng.standard_normal(shape) + np.where(np.indices(shape)[-1] < 9, 0.5, -0.5)
    edges = rng.uniform(0, 1, shape)
    u, _, gap = relax(evidence, edges, spacing, max_steps=4000, tolerance=1e-5)
    _, bound = slow_minimum(evidence, edges, spacing)
    scale = min(np.maximum(evidence, 0).sum(), np.maximum(-evidence, 0).sum())
    assert gap <= 1e-5
    assert u.min() >= 0
    assert u.max() <= 1
    # float32 sums of a few hundred terms
    assert energy(u, evidence, edges, spacing) - bound <= 3e-5 * scale


@pytest.mark.parametrize(("ratio", "kept"), [(0.9, False), (1.1, True)])
def test_a_disc_is_kept_above_its_cheeger_constant(ratio, kept):
    """A disc of radius r pays 2 pi r and gains strength pi r^2: it is kept where strength > 2 / r."""
    radius, size = 20.0, 64
    y, x = np.indices((size, size)) - size / 2 + 0.5
    strength = ratio * 2 / radius
    # A soft border keeps the digital disc's perimeter near the round one's.
    share = np.clip(radius - np.hypot(y, x) + 0.5, 0, 1)
    evidence = np.where(share > 0, strength * share, -1.0)
    u, _, _ = relax(evidence, np.ones((size, size)), (1, 1), max_steps=5000, tolerance=1e-4)
    area = float((u > 0.5).sum())
    assert (area > 0.8 * np.pi * radius**2) if kept else area == 0


def test_every_threshold_is_a_minimiser():
    """Chan, Esedoglu and Nikolova 2006. Discrete isotropic length is not additive over levels: 1.5 % were measured."""
    rng = np.random.default_rng(2)
    y, x = np.indices((80, 90))
    evidence = np.where(np.hypot(y - 40, x - 45) < 22, 1.0, -1.0) + rng.standard_normal((80, 90))
    u, _, _ = relax(evidence, np.full((80, 90), 2.0), (1, 1), max_steps=5000, tolerance=1e-5)
    lowest = energy(u, evidence, 2.0, (1, 1))
    reached = [energy((u > level).astype(float), evidence, 2.0, (1, 1)) for level in (0.3, 0.5, 0.7)]
    assert max(reached) <= lowest + 0.02 * abs(lowest)
    assert np.ptp(reached) <= 0.005 * abs(lowest)


def test_a_start_near_the_answer_saves_steps():
    rng = np.random.default_rng(3)
    y, x = np.indices((120, 130))
    evidence = np.where(np.hypot(y - 60, x - 60) < 30, 0.5, -0.5) + rng.standard_normal((120, 130))
    edges = np.ones((120, 130))
    u, _, _ = relax(evidence, edges, (1, 1), tolerance=1e-5, max_steps=5000)
    again, steps, gap = relax(evidence, edges, (1, 1), start=u, tolerance=3e-4)
    _, cold, _ = relax(evidence, edges, (1, 1), start=np.zeros_like(u), tolerance=3e-4)
    assert steps < cold
    assert gap <= 3e-4
    assert ((again > 0.5) != (u > 0.5)).mean() < 2e-3


def test_one_sided_evidence_labels_everything():
    ones = np.ones((40, 50))
    assert np.all(relax(ones, ones, (1, 1))[0] == 1)
    assert np.all(relax(-ones, ones, (1, 1))[0] == 0)
    # No length at all: the sign alone decides.
    sign = np.where(np.indices((40, 50))[0] % 3 == 0, 1.0, -1.0)
    assert np.array_equal(relax(sign, 0 * ones, (1, 1))[0] > 0.5, sign > 0)


def test_two_classes_are_two_regions():
    rng = np.random.default_rng(4)
    evidence = rng.standard_normal((50, 60)) + np.where(np.indices((50, 60))[0] < 25, 0.5, -0.5)
    edges = rng.uniform(0.5, 1, (50, 60))
    u, _, _ = relax(evidence, edges, (1, 1), max_steps=4000, tolerance=1e-5)
    shares, _, gap = classes([evidence, 0 * evidence], edges, (1, 1), max_steps=4000, tolerance=1e-5)
    assert gap <= 1e-5
    assert np.abs(shares.sum(axis=0) - 1).max() < 1e-5
    assert abs(energy(shares[0], evidence, edges, (1, 1)) - energy(u, evidence, edges, (1, 1))) < 0.02


def test_three_sectors_meet_at_a_straight_y():
    """Without evidence in the middle the shortest borders go on straight and meet under 120 degrees."""
    y, x = np.indices((61, 61)) - 30.0
    sector = np.floor((np.degrees(np.arctan2(y, x)) % 360) / 120).astype(int)
    known = np.hypot(y, x) > 24
    evidence = np.where(known, np.where(np.arange(3)[:, None, None] == sector, 5.0, -5.0), 0.0)
    shares, _, gap = classes(evidence, np.ones((61, 61)), (1, 1), max_steps=3000, tolerance=1e-4)
    assert gap <= 1e-4
    wrong = shares.argmax(axis=0) != sector
    assert wrong.mean() < 0.02


@pytest.mark.parametrize("shape", [(40, 44), (12, 14, 13)])
def test_classes_come_from_noise(shape):
    rng = np.random.default_rng(5)
    truth = np.minimum(np.indices(shape)[-1] // (shape[-1] // 4), 3)
    image = truth + 0.6 * rng.standard_normal(shape)
    evidence = [-((image - k) ** 2) / (2 * 0.6**2) for k in range(4)]
    shares, _, _ = classes(evidence, np.ones(shape), [1.0] * len(shape), tolerance=1e-3)
    assert (shares.argmax(axis=0) == truth).mean() > 0.97
    again, steps, _ = classes(evidence, np.ones(shape), [1.0] * len(shape), start=shares, tolerance=1e-3)
    assert steps <= 100
    assert (again.argmax(axis=0) == shares.argmax(axis=0)).mean() > 0.99


def test_the_bits_do_not_depend_on_threads():
    code = (
        "import hashlib, numpy as np; from tspline import _core;"
        "w = np.random.default_rng(0).standard_normal((40, 60, 70)).astype('f4');"
        "u, n, g = _core.relaxed_regions(w, np.ones_like(w), [2.0, 1.0, 1.0]);"
        "c, k, h = _core.relaxed_classes(np.stack([w, -w, 0 * w]), np.ones_like(w), [2.0, 1.0, 1.0]);"
        "print(hashlib.sha256(u.tobytes() + c.tobytes()).hexdigest(), n, g, k, h)"
    )
    outputs = {
        subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "RAYON_NUM_THREADS": str(threads)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for threads in (1, 3)
    }
    assert len(outputs) == 1


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"spacing": [1.0]}, "spacing"),
        ({"spacing": [1.0, 0.0]}, "spacing"),
        ({"edges": np.full((5, 6), -1, np.float32)}, "edges"),
        ({"edges": np.ones((6, 5), np.float32)}, "edges"),
        ({"evidence": np.full((5, 6), np.nan, np.float32)}, "evidence"),
        ({"evidence": np.asfortranarray(np.ones((5, 6), np.float32))}, "evidence"),
        ({"start": np.ones((6, 5), np.float32)}, "start"),
    ],
)
def test_bad_arguments_are_named(change, name):
    ones = np.ones((5, 6), np.float32)
    arguments = {"evidence": ones, "edges": ones, "spacing": [1.0, 1.0], **change}
    with pytest.raises(ValueError, match=name):
        _core.relaxed_regions(**arguments)


def test_one_class_alone_is_refused():
    with pytest.raises(ValueError, match="two classes"):
        _core.relaxed_classes(np.ones((1, 5, 6), np.float32), np.ones((5, 6), np.float32), [1.0, 1.0])

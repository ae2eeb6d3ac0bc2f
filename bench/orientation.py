"""`vrgs.py bench orientation`: how often the guessed up axis, and front, is right, and how often it says it is.

Procedural objects and scenes of other seeds than those the model was fitted to, and cuts of the shipped assets, none of
which it has seen. `--fit` fits the model anew and prints its coefficients for assets/up_axis.py.
"""

from __future__ import annotations

import sys

import numpy as np

from assets.file_access import check_writable
from assets.level_planes import AXES
from assets.splat_files import read_gaussians
from assets.up_axis import FILE_PRIOR, UNSURE, WEIGHTS, alternatives, probabilities_from, up_probabilities
from assets.up_cues import up_cues
from bench.orientation_cases import OrientationCase, front_cases, procedural_cases, shipped_cases
from display.run_stats import write_stats
from prepare.orientation.body_front import front_of

FIT_CASES, FIT_SEED, TEST_SEED = 1200, 1, 2
FRONT_TOLERANCE = np.radians(25.0)
RIDGE = 1e-3  # penalty on squared weights of cues of unit variance
BINS = np.linspace(0.0, 1.0, 11)  # of confidence, in the reliability table
EVEN = dict.fromkeys(AXES, 1 / len(AXES))  # the cases are turned evenly, unlike files


def run(args) -> None:
    """Run the command: measure, or fit, print tables, write --json."""
    if args.json:
        check_writable(args.json)
    if args.fit:
        fit_model(args.cases or FIT_CASES)
        return
    count, rows = args.cases or 300, []
    for what, cases in (
        ("procedural", procedural_cases(count, TEST_SEED)),
        ("shipped", shipped_cases(count, TEST_SEED)),
    ):
        found = with_cues(cases)
        for known in (True, False):
            said, right, families = measured(found, known)
            row = {"bench": "orientation", "what": what if known else f"{what}, of a kind that is not known"}
            row |= {"cases": len(said), **figures(said, right), "reliability": reliability(said, right)}
            rows.append(row | {"families": of_families(said, right, families)})
            print_table(rows[-1])
    said, right, families = measured_fronts(front_cases(max(1, count // 3), TEST_SEED))
    row = {"bench": "orientation", "what": "fronts", "cases": len(said), **figures(said, right)}
    rows.append(row | {"reliability": reliability(said, right), "families": of_families(said, right, families)})
    print_table(rows[-1])
    for path in args.names:
        p = up_probabilities(read_gaussians(path), FILE_PRIOR)
        ranked = ", ".join(f"{up} {p[up]:.0%}" for up in alternatives(p))
        print(f"{path}: {ranked}")
        rows.append({"bench": "orientation", "what": str(path), "probabilities": p})
    if args.json:
        write_stats(args.json, rows)


def with_cues(cases) -> list[tuple[OrientationCase, dict[str, dict[str, float]]]]:
    """Each case with the cues of its axes."""
    return [(case, up_cues(case.gaussians)) for case in cases]


def measured(found, known: bool = True) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Confidence of each guess (C,), whether it is right (C,), and the family of each case `with_cues`; the kind of the
    cases is said, or not known."""
    said, right, families = [], [], []
    for case, cues in found:
        p = probabilities_from(cues, EVEN, case.kind if known else None)
        up = max(p, key=p.get)
        said.append(p[up])
        right.append(up == case.up)
        families.append(case.family)
    return np.array(said), np.array(right), families


def measured_fronts(cases) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """As `measured`, of the front of shipped bodies that stand upright; right is within FRONT_TOLERANCE."""
    said, right, families = [], [], []
    for family, gaussians, angle in cases:
        found = front_of(gaussians)
        said.append(found.sure)
        right.append(np.cos(found.angle - angle) > np.cos(FRONT_TOLERANCE))
        families.append(family)
    return np.array(said), np.array(right), families


def figures(said: np.ndarray, right: np.ndarray) -> dict[str, float]:
    """Share that is right, mean confidence, the expected calibration error (Naeini 2015), and those of sure guesses."""
    bins = np.digitize(said, BINS[1:-1])
    shares = [((bins == k).mean(), abs(right[bins == k].mean() - said[bins == k].mean())) for k in np.unique(bins)]
    sure = said >= UNSURE
    return {
        "right": float(right.mean()),
        "said": float(said.mean()),
        "ece": float(sum(share * gap for share, gap in shares)),
        "sure": float(sure.mean()),
        "sure_right": float(right[sure].mean()) if sure.any() else float("nan"),
    }


def reliability(said: np.ndarray, right: np.ndarray) -> list[dict]:
    """Rows of the reliability table: the confidence said, the frequency observed, and of how many."""
    bins = np.digitize(said, BINS[1:-1])
    return [
        {
            "from": float(BINS[k]),
            "said": float(said[bins == k].mean()),
            "observed": float(right[bins == k].mean()),
            "cases": int((bins == k).sum()),
        }
        for k in np.unique(bins)
    ]


def of_families(said: np.ndarray, right: np.ndarray, families: list[str]) -> dict[str, list[float]]:
    """Share right, mean confidence and number of cases of each family."""
    families = np.array(families)
    return {
        str(f): [float(right[families == f].mean()), float(said[families == f].mean()), int((families == f).sum())]
        for f in np.unique(families)
    }


def print_table(row: dict) -> None:
    """A row with its reliability table."""
    print(
        f"\n{row['what']}, {row['cases']} cases: {row['right']:.1%} right, {row['said']:.1%} said, "
        f"ECE {row['ece']:.3f}; of the {row['sure']:.0%} said with {UNSURE:.0%} or more {row['sure_right']:.1%} right"
    )
    print(f"{'said':>8} {'observed':>9} {'cases':>6}")
    for line in row["reliability"]:
        print(f"{line['said']:8.1%} {line['observed']:9.1%} {line['cases']:6}")
    worst = sorted(row["families"].items(), key=lambda item: item[1][0] - item[1][1])[:4]
    print("most over-confident: " + ", ".join(f"{f} {r:.0%} ({s:.0%} said, {n})" for f, (r, s, n) in worst), flush=True)


# Fitting


def fit_model(count: int) -> None:
    """Fit the weights and the lapse of each kind to procedural cases, then the pool of both to all cases; print all."""
    print(f"cues of {count} cases ...", file=sys.stderr, flush=True)
    found = with_cues(procedural_cases(count, FIT_SEED))
    x, y = table(found)
    kinds, votes = np.array([case.kind for case, _ in found]), []
    for kind, names in WEIGHTS.items():
        weights, lapse = fitted(x[kinds == kind], y[kinds == kind])
        votes.append(x @ weights)
        print_fit(f'WEIGHTS["{kind}"]', names, weights, f'LAPSE["{kind}"]', lapse)
    parts, lapse = fitted(np.stack(votes, 2), y, ridge=0.0)
    print_fit("POOL", WEIGHTS, parts, "LAPSE[None]", lapse)


def print_fit(what: str, names, weights: np.ndarray, lapse_of: str, lapse: float) -> None:
    """Coefficients, as assets/up_axis.py has them."""
    print(f"{what} = {{")
    for name, weight in zip(names, weights, strict=True):
        print(f'    "{name}": {weight:.3g},')
    print(f"}}\n{lapse_of} = {lapse:.2g}", flush=True)


def table(found) -> tuple[np.ndarray, np.ndarray]:
    """Cues (C, 6, K) of the axes of cases `with_cues`, and the index (C,) of the one that is up."""
    axes, names = list(AXES), list(WEIGHTS["body"])
    x = np.array([[[cues[up][name] for name in names] for up in axes] for _, cues in found])
    return x, np.array([axes.index(case.up) for case, _ in found])


def fitted(x: np.ndarray, y: np.ndarray, ridge: float = RIDGE) -> tuple[np.ndarray, float]:
    """Weights (K,) and lapse of the conditional logit (McFadden 1974) of cues (C, 6, K) and answers (C,)."""
    from scipy.optimize import minimize

    width = x.reshape(-1, x.shape[2]).std(axis=0)
    x = x / width

    def loss(v: np.ndarray) -> float:
        vote = x @ v[:-1]
        p = np.exp(vote - vote.max(axis=1, keepdims=True))
        p /= p.sum(axis=1, keepdims=True)
        lapse = 1 / (1 + np.exp(-v[-1]))
        p = (1 - lapse) * p[np.arange(len(y)), y] + lapse / x.shape[1]
        return -np.log(p).mean() + ridge * (v[:-1] ** 2).sum()

    v = minimize(loss, np.append(np.zeros(x.shape[2]), -3.0), method="L-BFGS-B").x
    return v[:-1] / width, float(1 / (1 + np.exp(-v[-1])))

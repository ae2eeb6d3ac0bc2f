"""TetGen in a process of its own: INPUT.npz with a surface in, OUTPUT.npz with tetrahedra out.

Needs only NumPy and tetgen, so that it can run in another environment. Exit status 3: tetgen is not installed;
4: TetGen failed, with its reason as the last line of stderr.
"""

import sys


def main(source: str, target: str) -> int:
    """Fill the surface in `source`: vertices (V, 3), faces (F, 3), maxvolume, minratio and mindihedral [degrees]."""
    try:
        import numpy as np
        import tetgen
    except ImportError as e:
        print(e, file=sys.stderr)
        return 3
    with np.load(source, allow_pickle=False) as given:
        vertices, faces = given["vertices"].astype(np.float64), given["faces"].astype(np.int32)
        limits = {name: float(given[name]) for name in ("maxvolume", "minratio", "mindihedral")}
    try:
        mesher = tetgen.TetGen(np.ascontiguousarray(vertices), np.ascontiguousarray(faces))
        found = mesher.tetrahedralize(
            plc=True, quality=True, quiet=True, fixedvolume=True, nobisect=True,  # the surface stays unchanged
            optmaxdihedral=150.0, opt_iterations=10, smooth_maxiter=20, **limits,
        )  # fmt: skip
    except Exception as e:  # any error: the caller takes another mesher
        print(f"{type(e).__name__}: {e}", file=sys.stderr)
        return 4
    np.savez(target, vertices=np.asarray(found[0], np.float64), tets=np.asarray(found[1], np.int64))
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:3]))

"""One size for every block-shared array, because Taichi confuses arrays of different sizes.

Taichi 1.7.4 names a shared array after its statement's number, which starts anew in each top-level loop,
and links all loops of a kernel together: two arrays that draw the same number become one of the smaller size,
and writes beyond it fault (CUDA_ERROR_ILLEGAL_ADDRESS, or silent damage). With one size there is nothing to confuse.
"""

WORDS = 8704  # 34 KiB: counts, and ranks, keys and values of 2048 items to sort; 6 such blocks fit on a multiprocessor

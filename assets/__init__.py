"""Contents of files: how they are read, checked and written (NumPy, h5py).

In: files from untrusted sources. Out: checked Gaussians, assets, animations; and files that are complete or absent.
"""

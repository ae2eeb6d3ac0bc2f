"""What files hold, and how it is read, written and checked (NumPy, h5py).

In: files from anywhere. Out: checked Gaussians, assets, animations; and files that are whole or not there.
"""

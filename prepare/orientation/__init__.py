"""Which way is up, how large, which side is the front.

From the cameras of a capture where there are some, and pictures of the possible answers where there are none.
"""

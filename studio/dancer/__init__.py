"""The dancer: a doll half a person's size with a skeleton and a dance, a skirt and a ponytail that swing.

In: nothing but code. Out: the asset `dancer`. Its body is prepared as a user's would be (prepare/rig).
"""

"""The user study: what participants do in each setting, what they answer, and how the settings compare.

In: the frames of a play and its world; answers to the questionnaire. Out: a file of trials, a table, CSV.
"""

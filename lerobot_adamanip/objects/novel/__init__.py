"""Novel objects: kinds, combinations and proportions that no seen object has, one file per category.

What the seen ones and the unseen ones share, their kinds, is left out here: a novel safe has a handle and a knob of
another make and another shape altogether. Mechanisms, joints and parts are the category's own.
"""

"""Physics: whether a grasp holds.

`protocols` states the conditions and needs no simulator; `grasp_trial` and `validate` need MuJoCo.
"""

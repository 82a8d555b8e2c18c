"""Two cameras: how they stand, what one picture says about the other, and pictures whose rows match.

==========================  ==============================================================================
``rig``                     two cameras and the motion between them
``stereo_calibration``      R, T and both cameras from boards that both see
``corner_order``            one corner order for both pictures of a pair
``diagnosis``               what is wrong with a set of pairs: flips, mispairing, late shutters, knocks, bends
``view_rigs``               the rig as each view sees it, and its deviation from the rig of all
``board_heights``           the board's shape from what its corners leave over
``epipolar``                epipolar lines and distances, the nearest pair that satisfies F
``two_view_solvers``        F from eight or seven points, E from five
``consensus``               a model from matches of which many are wrong: MSAC, LMedS
``two_view_refinement``     Gold-Standard refinement of F and of R, t
``fundamental``             the fundamental matrix [eq 20]
``essential``               the essential matrix and the motion in it [eq 21]
``rectifying_rotations``    Bouguet's rotations: rows that match
``rectified_view``          which part of the plane the rectified pictures show
``rectification``           P₁, P₂, Q, maps and pictures from a calibrated rig
``rectification_advice``    what is odd about a rig, in words
``uncalibrated``            rectification from points and F alone (Hartley)
==========================  ==============================================================================
"""

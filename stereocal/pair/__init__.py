"""Two cameras, or more: how they stand, what one picture says about the other, and pictures whose rows match.

==========================  ==============================================================================
``rig``                     two cameras and the motion between them
``stereo_calibration``      R, T and both cameras from boards that both see
``rig_calibration``         any number of cameras, from boards that some of them see
``rig_inputs``              what the user passes to the two, sorted by camera
``rig_start``               where their fit starts: from each camera by itself
``rig_solution``            the joint fit itself, of any number of cameras
``rig_agreement``           views that do not fit the rig of the others, or no rig at all
``corner_order``            one corner order for both pictures of a pair
``diagnosis``               what is wrong with a set of pairs: flips, mispairing, late shutters, knocks, bends
``findings``                one thing that is wrong: what a diagnosis is made of
``view_pairing``            which right view belongs to each left one, and how its corners are counted
``rig_motion``              views that see different rigs: knocks, late shutters, single views gone wrong
``view_rigs``               the rig as each view sees it, and its deviation from the rig of all
``board_heights``           the board's shape from what its corners leave over
``epipolar``                epipolar lines and distances, the nearest pair that satisfies F
``two_view_solvers``        F from eight or seven points, E from five
``two_view_models``         F in seven numbers, a motion in five: what a refinement may change
``two_view_refinement``     Gold-Standard refinement of F and of R, t, among outliers too
``two_view_modes``          several maxima of the likelihood, and one answer: their mean
``two_view_options``        the options that the fits of F and of E share
``two_view_degeneracy``     matches that determine nothing, by name: planes, pure rotation, copies
``consensus``               a model from matches of which many are wrong: MSAC, LMedS
``fundamental``             the fundamental matrix [eq 20]
``essential``               the essential matrix [eq 21]
``relative_pose``           the motion in an essential matrix: four of them, and which one is seen
``rectifying_rotations``    Bouguet's rotations: rows that match
``rectified_view``          which part of the plane the rectified pictures show
``rectification``           P₁, P₂, Q, maps and pictures from a calibrated rig
``rectification_advice``    what is odd about a rig, in words
``search_direction``        swapped and vertical rigs: pictures turned so that every matcher finds the partner
``uncalibrated``            rectification from points and F alone (Hartley)
``…_kernels``               the compiled twins of the module whose name they bear
==========================  ==============================================================================
"""

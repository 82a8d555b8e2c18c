"""Is it any good: what is measured on a calibration, what is said about it, and the page that shows both.

========================  =====================================================================================
``quality``               :func:`evaluate_calibration`, the report as one object: verdicts, figures, HTML, JSON
``verdicts``              a verdict: a figure, its threshold, the threshold's source, cause and next action
``thresholds``            every threshold in one table, each with its source
``evidence``              a calibration and its corners, laid out for measuring: residuals, rays, depths
``coverage``              block 1, data: where the boards were seen, and which photographs to add
``fit``                   block 2, fit: RMS in every convention, outliers, structure left in the residuals
``parameters``            block 3: values with σ, correlations, plausibility
``held_out``              block 4, generalisation: fits that have not seen the view they are judged on
``halves``                block 4: two half-data calibrations against the uncertainty that was promised
``rectified``             block 5, epipolar: what is left of Δy after rectification
``metric``                block 6: triangulated squares, flatness and shape of the board
``depth_error``           block 7: σ_Z from disparity noise and the calibration's covariance together
``scene``                 block 8: disparity of a scene, and the paper's sweep
``left_right``            which disparities the right image confirms
``board_bend``            is the board flat: one step of the fit with its shape free
``rig_parameters``        a rig as a vector, and what a change of it does to depth
``thumbnails``            small photographs with corners
``advice``                which photographs to add, in plain words
``style``                 one look for every picture
``figures_images``        pictures with photographs in them
``figures_detection``     how a board was found, or how far the search got
``figures_residuals``     pictures of what the fit leaves over
``figures_board``         the board's shape: a map, and profiles with its hinge
``figures_geometry``      the rig in space, coverage, maps over the image
``figures_curves``        σ_Z over distance, the paper's figures 7 and 8
``figures_benchmarks``    pictures of ``bench``: ratio a kernel, time against size
``page``                  the self-contained HTML page
========================  =====================================================================================
"""

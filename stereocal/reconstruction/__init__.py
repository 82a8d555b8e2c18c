"""Dense reconstruction: from a rectified pair to disparity, depth and points.

============================  ====================================================================
``sad``                       the paper's block matching: the smallest sum of absolute differences
``block_matching``            the same with OpenCV's tests around it: StereoBM, bit for bit
``block_matching_reference``  that recipe in NumPy, to be read
``sliding_window``            the engine of both: sums that are updated as a window slides
``census``                    matching by the order of grey values, for unequal exposures
``matching_costs``            how alike two pixels are: census, Birchfield-Tomasi, differences
``semiglobal``                matching with a smoothness term along many paths
``semiglobal_sweeps``         how its sweeps share memory and threads
``winner``                    from costs to disparities, and which of them to believe
``speckles``                  small islands of the disparity map are removed
``islands``                   islands that are too small, or have no texture to be matched by
``postprocessing``            weighted median, hole filling, confidence
``triangulation``             a point in space from its two images
``depth``                     from disparity to depth and points, and how far to trust them
============================  ====================================================================

Beneath them: ``vector_primitives`` and ``vector_lanes`` (explicit vectors in Numba), ``row_bands`` (threads).
Each ``…_kernels`` module holds the Numba kernels of the module whose name it bears.
"""

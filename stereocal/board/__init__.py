"""The target, and how it is found in a picture.

=====================  ===========================================================================
``chessboard``         the target: how many corners, how large, which is the first
``harris``             Harris response and corner list, the paper's [eq 2a-10]
``pyramid``            the levels a board is looked for at
``saddle``             saddle points: what an inner corner is
``ring``               the ring test: a crossing all the way round
``links``              neighbours, closed cells, coordinates
``growth``             missing corners by local prediction
``grid``               grids from corners: links, then growth
``selection``          which part of a grid is the board, which corner is first
``detection``          the whole way from a picture to the board's corners
``measuring``          the fit of a found board, and what stands in where it does not hold
``subpixel``           fit of a blurred saddle, covariance of each corner
``saddle_model``       the readable twin of that fit
``subpixel_geometry``  steps, bends and windows that the fit looks through
``subpixel_masks``     corners in shadows, under fingers and ink: the pixels that can be explained
``corner_errors``      how far the covariances can be trusted, judged by the grid
``printing``           a target to print, true to scale
``*_kernels``          the Numba kernels beside them
=====================  ===========================================================================
"""

"""The target, and how it is found in a picture.

==================  ===========================================================
``chessboard``      the target: how many corners, how large, which is the first
``harris``          Harris response and corner list, the paper's [eq 2a-10]
``saddle``          saddle corners: what an inner corner is, the ring test
``grid``            neighbours, closed cells, growth by local prediction
``detection``       the whole way from a picture to the board's corners
``subpixel``        fit of a blurred saddle, covariance of each corner
``saddle_model``    the readable twin of that fit
``printing``        a target to print, true to scale
``*_kernels``       the Numba kernels beside them
==================  ===========================================================
"""

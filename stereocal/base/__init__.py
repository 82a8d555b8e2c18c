"""What everything stands on.

===================  ==========================================================
``errors``           the three ways a job fails, as exception types
``checks``           input validation, done once, at the public boundary
``gray``             any image to one grey channel
``rotations``        Rodrigues' formula, its inverse and its derivative
``homogeneous``      homogeneous coordinates, the cross-product matrix
``least_squares``    Levenberg-Marquardt, the solver of every fit in the library
``equations``        the paper's equations: printed, corrected, implemented by
``atomic_files``     files written whole or not at all
``kernel_cache``     where compiled kernels are kept, on read-only machines too
``compile_ahead``    kernels compiled by a second process while this one is busy
``lazy``             names that import their module when first used
===================  ==========================================================
"""

"""One camera: how it sees a point, and how it is calibrated from views of a board.

==================================  ==========================================================================
``model``                           Camera: matrix, lens, image size
``projection``                      from a point in space to a pixel, with derivatives
``distortion``                      distort and undistort points, with any lens model by name
``distortion_base``                 what a lens model is; how to add one
``distortion_polynomial``           none, and the paper's k1, k2 in both directions
``distortion_brown``                OpenCV's family: 5, 8, 12 and 14 coefficients
``distortion_fisheye``              Kannala and Brandt's
``distortion_fov``                  field of view
``distortion_division``             division
``distortion_rational_function``    a 3×6 matrix on monomials of degree two
``distortion_inverse``              undoing a lens where it can be undone
``distortion_inverse_kernels``      the same, compiled
``homography``                      the plane's homography, by the direct linear transform
``homography_kernels``              many at once, compiled
``zhang``                           camera matrix and pose from homographies, in closed form
``calibration``                     calibrate_camera: from corners to a camera with its uncertainty
``seen_boards``                     the homographies of all views and the poses they give
``camera_starts``                   candidates for the camera matrix
``pose_reversal``                   Necker's reversal: boards tilted the other way
``initialisation``                  where the iteration starts
``optima``                          what an optimum is, and which of several wins
``lens_starts``                     where a lens starts
``pole_search``                     where the poles of a rational lens may lie
``lens_doubts``                     what a fit leaves open: coefficients that trade, kinks, a centre adrift
``bundle``                          bundle adjustment: residuals, derivatives, block normal equations
``bundle_compiled``                 its arrays, laid out for kernels
``bundle_kernels``                  residuals and normal equations, compiled
``tile_products``                   sixteen sums of products at once, for them
``bundle_solver``                   Levenberg–Marquardt on the blocks
``bundle_step_kernels``             its steps, compiled
``bundle_sums``                     normal equations for lenses without columns in the kernels
``bundle_sums_kernels``             their sums, compiled
``bundle_geodesic``                 steps that bend along a valley
``bundle_shaped``                   the engine for a board of unknown shape, by small blocks
``bundle_shaped_kernels``           its equations and steps, compiled
``bundle_problem``                  from lists of views to flat arrays
``board_shape``                     the board's shape as unknowns
``board_shape_fit``                 fitting it, and asking held-out views
``odd_views``                       views whose corners are in another order, named
``outliers``                        corners that do not belong
``refinements``                     from the plain optimum to the one asked for
``priors``                          what is known beforehand
``covariance``                      how sure the answer is
``degeneracy``                      views that do not determine a camera, named
``propagation``                     what that means for pixels and for points in space
``losses``                          robust losses
``parameters``                      which parameters are free, held or tied, by name
``pose``                            poses of a board seen by a known camera
``views``                           points as users pass them, in one layout
``undistortion``                    maps that straighten an image
``undistortion_kernels``            the same, compiled
``vector_doubles``                  eight numbers as one value in kernels
``resampling``                      images looked up at fractional places
``resampling_kernels``              the same, compiled
==================================  ==========================================================================
"""

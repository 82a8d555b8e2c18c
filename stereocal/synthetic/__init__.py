"""Rendered rigs with known truth: what the demo, the tests and the notebooks take for true.

=======================  ==============================================================================================
``rays``                 the ray behind every sample of a pixel: the lens undone, to convergence
``exposure``             from light to grey levels: blur, pixel area, vignetting, noise, quantisation
``board_view``           a chessboard, flat or bent, seen by a camera
``surfaces``             planes, boxes and spheres, and where a ray meets them
``scene``                a room of textured surfaces: the picture, its depth, its disparity and what is hidden
``poses``                how a board is held up in front of a rig
``corners``              projected corners with noise and no pictures, for Monte Carlo studies
``rig``                  all of it together: a stereo rig, its photographs and their truth
``rendering_kernels``    the same loops, compiled
=======================  ==============================================================================================
"""

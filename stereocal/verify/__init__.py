"""The oracle: the only room that imports OpenCV to compare against it.

=========================  ===================================================================================
``opencv_calls``           OpenCV's functions with this library's shapes, the same for 4.x and 5.x
``comparison``             what a comparison says of one step, and of all of them
``second_opinion``         ``crosscheck``: every step of a calibration by both libraries
``crosscheck_points``      its steps that need corners
``crosscheck_given``       is the given calibration at an optimum, and how far from it
``crosscheck_images``      its steps that need only the rig
``function_checks``        is my function right? A function in, a report out
``function_cases``         the kernels that it knows, with the mistakes that people make
``pytest_plugin``          the same as a fixture for another test-suite
``bench``                  kernels beside OpenCV, in turns; the cases stand in ``bench_<room>``
``benchmark_photographs``  the same on a user's own photographs
``benchmark_worker``       the same in another Python, with its own OpenCV
``peak_memory``            what a call takes beyond what was there, whoever asks for it
=========================  ===================================================================================
"""

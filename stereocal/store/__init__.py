"""Everything that touches a disk or a device.

=======================  ==============================================================================================
``images``               photographs: every pixel format taken deliberately, hostile files refused
``disparity_files``      disparity maps: PFM, KITTI and Middlebury PNG, OpenCV's int16, NPY
``clouds``               point clouds: PLY
=======================  ==============================================================================================
"""

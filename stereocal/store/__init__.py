"""Everything that touches a disk or a device.

=======================  ==============================================================================================
``images``               photographs: every pixel format taken deliberately, hostile files refused
``sixteen_bits``         colour of 16 bits a channel: PNG, TIFF, PPM
``disparity_files``      disparity maps: PFM, KITTI and Middlebury PNG, OpenCV's int16, NPY
``clouds``               point clouds: PLY
``calibrations``         calibrations of any tool: load, save, convert; the registry of formats
``calibration_record``   what stands between two formats: cameras, unit of length, remarks
``lens_refit``           a lens of fewer parameters for formats that hold no more, and its misfit
``structured_text``      JSON, YAML and XML from strangers, parsed as data only
``opencv_filestorage``   OpenCV's FileStorage without OpenCV
``format_stereocal``     our own calibration.json, lossless
``format_opencv``        OpenCV's stereo_calib and calibration samples: YAML, XML, JSON
``format_ros``           ROS camera_info: left.yaml, right.yaml
``format_kalibr``        Kalibr's camchain.yaml
``format_boofcv``        BoofCV's stereo.yaml
``format_matlab``        MATLAB's stereoParameters as a struct: .mat, JSON
``matlab_structs``       .mat of version 5 from strangers, every count checked
``format_mrcal``         mrcal's .cameramodel
``format_colmap``        COLMAP's cameras.txt
``format_kitti``         KITTI's calib.txt
``format_middlebury``    Middlebury 2014's calib.txt
``rectified_pairs``      what the last two can hold
``format_paper``         the npz of the paper's own code: the rig found again from its maps
``datasets``             the public photographs: where they lie, what is known of them, how they are fetched
``capture``              photographs from two cameras or a side-by-side one
=======================  ==============================================================================================
"""

"""Receivers' own files: the messages in raw logs and bags, and a file by itself as a recording.

bags           topics of ROS bags and MCAP as tables
log_order      logs put together in the order of their time
raw_frames     messages of UBX, SBF, RTCM 3 and NovAtel OEM, found by their checksums
receiver_file  a raw log or RINEX observations without an IMU
"""

"""`camcal report` and `camcal rerun`, and the pages that `calibrate` and `rig` write."""

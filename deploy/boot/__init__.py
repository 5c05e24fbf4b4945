"""What deploy/test-boot is made of: a Debian tree, its boot, a rig inside it, and the points that are checked there."""

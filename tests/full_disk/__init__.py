"""Writing commands on disks that are full at every page they write, become read-only, or vanish."""

"""Pictures in and out: sequences on disk, other programs' captures, built-in scenes, `gffe run`, the doctor."""

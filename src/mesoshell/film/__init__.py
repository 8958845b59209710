"""A scene over time: cameras that move, keys, frames on the disk, and how much they flicker."""

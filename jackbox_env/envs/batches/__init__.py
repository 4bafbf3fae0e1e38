"""Many environments side by side, behind one interface: compiled for the exact contact model, one by one otherwise."""

"""C of learned output functions: networks and trees of scikit-learn."""

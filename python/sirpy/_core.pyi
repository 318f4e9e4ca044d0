"""Types of the C++ core; arrays are C-contiguous unless said otherwise."""

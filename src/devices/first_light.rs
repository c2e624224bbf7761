//! What each device of a bench can and cannot do.

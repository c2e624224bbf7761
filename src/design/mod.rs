//! Designing a rig: what a dome will measure, what its tolerances cost, and which dimensions serve best. Pure.


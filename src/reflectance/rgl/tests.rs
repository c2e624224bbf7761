//! Tests of the reader and of the evaluation on small files made here.
use super::*;

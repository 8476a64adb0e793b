//! What can go wrong in a kernel.

use std::fmt;

/// An input that a kernel refuses, in words that a user can act on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum KernelError {
    /// The input does not describe what it should (a tree, coefficients, samples).
    Invalid(String),
    /// The work asked for exceeds the stated limit.
    TooLarge(String),
    /// A linear system could not be solved to the accuracy asked for.
    NotSolved(String),
}

/// Result of a kernel.
pub type Result<T> = std::result::Result<T, KernelError>;

impl fmt::Display for KernelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Invalid(text) | Self::TooLarge(text) | Self::NotSolved(text) => f.write_str(text),
        }
    }
}

impl std::error::Error for KernelError {}

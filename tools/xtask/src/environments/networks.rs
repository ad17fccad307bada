//! The buses of isolated environments, which a namespace and a virtual machine set up alike.

/// Sets up buses in a root shell of an isolated environment.
pub(crate) const NETWORKS: &str = include_str!("../networks.sh");

//! Whether a virtual machine is available here. A missing one is no failure of the tests.

/// Why no machine is available here. Not a failure of the tests.
#[derive(Debug)]
pub(crate) struct Unavailable(pub(crate) String);

/// The requested item, or why it is unavailable, or an error.
pub(crate) type Availability<T> = anyhow::Result<Result<T, Unavailable>>;

/// Fails if the user disabled machines, or if this is one.
pub(super) fn refused() -> Result<(), Unavailable> {
    match std::env::var("TAKT_VM").as_deref() {
        Ok("off") => Err(Unavailable("needs TAKT_VM unset; it is off".to_owned())),
        Ok("inside") => Err(Unavailable(
            "needs a host; this is a virtual machine".to_owned(),
        )),
        Ok(_) | Err(_) => Ok(()),
    }
}

//! Numbers and conditions with the operators of Python.

use pyo3::basic::CompareOp;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use takt_api as api;

use crate::error;
use crate::wait::seconds;

/// A number that the controller evaluates in each cycle.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Number(pub(crate) api::Number);

/// A state that the controller evaluates in each cycle.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Condition(pub(crate) api::Condition);

/// The other side of an operator.
#[derive(FromPyObject)]
pub(crate) enum Operand<'py> {
    Number(Bound<'py, Number>),
    Constant(f64),
}

impl Operand<'_> {
    pub(crate) fn number(self, py: Python<'_>) -> PyResult<api::Number> {
        match self {
            Self::Number(number) => Ok(number.get().0.clone()),
            Self::Constant(value) if value.is_finite() => Ok(value.into()),
            Self::Constant(value) => {
                let text = format!("{value} in an expression; constants are finite");
                Err(error::invalid(py, text))
            }
        }
    }
}

#[pymethods]
impl Number {
    fn __add__(&self, py: Python<'_>, other: Operand<'_>) -> PyResult<Self> {
        Ok(Self(self.0.clone() + other.number(py)?))
    }

    fn __radd__(&self, py: Python<'_>, other: Operand<'_>) -> PyResult<Self> {
        Ok(Self(other.number(py)? + self.0.clone()))
    }

    fn __sub__(&self, py: Python<'_>, other: Operand<'_>) -> PyResult<Self> {
        Ok(Self(self.0.clone() - other.number(py)?))
    }

    fn __rsub__(&self, py: Python<'_>, other: Operand<'_>) -> PyResult<Self> {
        Ok(Self(other.number(py)? - self.0.clone()))
    }

    fn __mul__(&self, py: Python<'_>, other: Operand<'_>) -> PyResult<Self> {
        Ok(Self(self.0.clone() * other.number(py)?))
    }

    fn __rmul__(&self, py: Python<'_>, other: Operand<'_>) -> PyResult<Self> {
        Ok(Self(other.number(py)? * self.0.clone()))
    }

    fn __truediv__(&self, py: Python<'_>, other: Operand<'_>) -> PyResult<Self> {
        Ok(Self(self.0.clone() / other.number(py)?))
    }

    fn __rtruediv__(&self, py: Python<'_>, other: Operand<'_>) -> PyResult<Self> {
        Ok(Self(other.number(py)? / self.0.clone()))
    }

    fn __neg__(&self) -> Self {
        Self(-self.0.clone())
    }

    fn __abs__(&self) -> Self {
        self.abs()
    }

    /// Its magnitude.
    fn abs(&self) -> Self {
        Self(self.0.clone().abs())
    }

    /// Its square root; a negative number has none, and nothing holds of it.
    fn sqrt(&self) -> Self {
        Self(self.0.clone().sqrt())
    }

    /// Sine of an angle, rad.
    fn sin(&self) -> Self {
        Self(self.0.clone().sin())
    }

    /// Cosine of an angle, rad.
    fn cos(&self) -> Self {
        Self(self.0.clone().cos())
    }

    /// Tangent of an angle, rad.
    fn tan(&self) -> Self {
        Self(self.0.clone().tan())
    }

    /// Arc sine, rad.
    fn asin(&self) -> Self {
        Self(self.0.clone().asin())
    }

    /// Arc cosine, rad.
    fn acos(&self) -> Self {
        Self(self.0.clone().acos())
    }

    /// Its mean over the last `duration` (s), or since the start if that is less.
    fn average(&self, py: Python<'_>, duration: f64) -> PyResult<Self> {
        let duration = seconds(py, "duration", duration)?;
        Ok(Self(self.0.clone().average(duration)))
    }

    /// The smaller of both.
    fn min(&self, py: Python<'_>, other: Operand<'_>) -> PyResult<Self> {
        Ok(Self(self.0.clone().min(other.number(py)?)))
    }

    /// The larger of both.
    fn max(&self, py: Python<'_>, other: Operand<'_>) -> PyResult<Self> {
        Ok(Self(self.0.clone().max(other.number(py)?)))
    }

    /// Whether it is greater than `limit`.
    fn over(&self, py: Python<'_>, limit: Operand<'_>) -> PyResult<Condition> {
        Ok(Condition(self.0.clone().over(limit.number(py)?)))
    }

    /// Whether it is less than `limit`.
    fn under(&self, py: Python<'_>, limit: Operand<'_>) -> PyResult<Condition> {
        Ok(Condition(self.0.clone().under(limit.number(py)?)))
    }

    fn __richcmp__(
        &self,
        py: Python<'_>,
        other: Operand<'_>,
        operator: CompareOp,
    ) -> PyResult<Condition> {
        match operator {
            CompareOp::Gt => self.over(py, other),
            CompareOp::Lt => self.under(py, other),
            CompareOp::Ge | CompareOp::Le | CompareOp::Eq | CompareOp::Ne => {
                let text =
                    "measured numbers are compared by > and <, as they are never exactly equal";
                Err(PyTypeError::new_err(text))
            }
        }
    }

    fn __bool__(&self) -> PyResult<bool> {
        not_here()
    }

    fn __repr__(&self) -> String {
        format!("{:?}", self.0)
    }
}

#[pymethods]
impl Condition {
    fn __and__(&self, other: &Bound<'_, Self>) -> Self {
        Self(self.0.clone() & other.get().0.clone())
    }

    fn __or__(&self, other: &Bound<'_, Self>) -> Self {
        Self(self.0.clone() | other.get().0.clone())
    }

    fn __invert__(&self) -> Self {
        Self(!self.0.clone())
    }

    /// Whether it has just become true; also if it is true from the start.
    fn rises(&self) -> Self {
        Self(self.0.clone().rises())
    }

    /// Whether it has just become false; also if it is false from the start.
    fn falls(&self) -> Self {
        Self(self.0.clone().falls())
    }

    /// Whether it holds once another condition has held since the activity began.
    fn after(&self, other: &Bound<'_, Self>) -> Self {
        Self(self.0.clone().after(other.get().0.clone()))
    }

    /// Whether it has been true for `duration` (s) without a break.
    fn lasting(&self, py: Python<'_>, duration: f64) -> PyResult<Self> {
        let duration = seconds(py, "duration", duration)?;
        Ok(Self(self.0.clone().lasting(duration)))
    }

    fn __bool__(&self) -> PyResult<bool> {
        not_here()
    }

    fn __repr__(&self) -> String {
        format!("{:?}", self.0)
    }
}

fn not_here() -> PyResult<bool> {
    let text = "the controller evaluates it, in each cycle; the program has no value of it\n\
                hint: use & | ~ instead of `and`, `or`, `not`, and `until=` instead of `if`";
    Err(PyTypeError::new_err(text))
}

//! Poses, and what Python programs use for them: 4x4 arrays, position and quaternion, rotations of scipy.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use takt_api as api;

use crate::arrays::array;
use crate::error;
use crate::frame::{Frame, Goal};

/// How far a matrix may be from a rotation.
const MATRIX_TOLERANCE: f64 = 1e-6;

/// An angle in degrees as radians.
#[pyfunction]
pub(crate) fn deg(angle: f64) -> f64 {
    api::deg(angle)
}

/// A position and an orientation in a reference frame, by default the base of the arm that moves there.
#[pyclass(frozen, eq, module = "takt")]
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pose(pub(crate) api::Pose);

#[pymethods]
impl Pose {
    /// A pose from what is accepted wherever a pose is expected: a pose, a 4x4 matrix, or a position and an orientation.
    #[new]
    #[pyo3(signature = (pose, orientation=None))]
    fn new(pose: &Bound<'_, PyAny>, orientation: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        orientation
            .map_or_else(|| read(pose), |rotation| pair(pose, rotation))
            .map(Self)
    }

    /// A position, m, with the orientation of the reference frame.
    #[staticmethod]
    fn xyz(x: f64, y: f64, z: f64) -> Self {
        Self(api::Pose::xyz(x, y, z))
    }

    /// The same position, turned by `a` about z, then by `b` about the new y, then by `c` about the new x, rad.
    fn abc(&self, a: f64, b: f64, c: f64) -> Self {
        Self(self.0.abc(a, b, c))
    }

    /// A position, m, and a quaternion with its scalar last, which is normalised.
    #[staticmethod]
    fn quaternion(position: [f64; 3], quaternion: [f64; 4]) -> Self {
        Self(api::Pose::quaternion(position, quaternion))
    }

    /// Position, m: array of 3.
    #[getter]
    fn position<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.0.position().to_vec())
    }

    /// Orientation: quaternion, scalar last, array of 4.
    #[getter]
    fn orientation<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.0.orientation().to_vec())
    }

    /// The homogeneous matrix, 4x4.
    fn matrix<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let matrix = self.0.isometry().to_homogeneous();
        let rows: Vec<Vec<f64>> = matrix
            .row_iter()
            .map(|row| row.iter().copied().collect())
            .collect();
        array(py, rows)
    }

    /// This pose in a frame of the cell, as a goal.
    fn in_(&self, frame: &Bound<'_, Frame>) -> Goal {
        Goal(self.0.in_(&frame.get().0))
    }

    /// The pose of the reference frame in this one.
    fn inverse(&self) -> Self {
        Self(self.0.isometry().inverse().into())
    }

    #[pyo3(signature = (dtype=None, copy=None))]
    fn __array__<'py>(
        &self,
        py: Python<'py>,
        dtype: Option<Bound<'py, PyAny>>,
        copy: Option<bool>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let _ = copy; // It is always one.
        let matrix = self.matrix(py)?;
        match dtype {
            Some(dtype) => matrix.call_method1("astype", (dtype,)),
            None => Ok(matrix),
        }
    }

    fn __mul__(&self, other: &Bound<'_, Self>) -> Self {
        Self(self.0 * other.get().0)
    }

    fn __matmul__(&self, other: &Bound<'_, Self>) -> Self {
        self.__mul__(other)
    }

    fn __repr__(&self) -> String {
        let [x, y, z] = self.0.position();
        let (c, b, a) = self.0.isometry().rotation.euler_angles();
        format!("Pose.xyz({x:.4}, {y:.4}, {z:.4}).abc({a:.4}, {b:.4}, {c:.4})")
    }
}

/// Reads whatever stands for a pose.
pub(crate) fn read(value: &Bound<'_, PyAny>) -> PyResult<api::Pose> {
    if let Ok(pose) = value.cast::<Pose>() {
        return Ok(pose.get().0);
    }
    if let Ok((position, orientation)) = value.extract::<(Bound<'_, PyAny>, Bound<'_, PyAny>)>() {
        return pair(&position, &orientation);
    }
    let matrix = if value.hasattr("as_matrix")? {
        value.call_method0("as_matrix")?
    } else {
        value.clone()
    };
    match matrix.extract::<[[f64; 4]; 4]>() {
        Ok(rows) => homogeneous(value.py(), rows),
        Err(_) => Err(PyTypeError::new_err(format!(
            "`{}` is no pose\nhint: a pose is a takt.Pose, a 4x4 matrix, or a position with a quaternion (x, y, z, w) or scipy Rotation",
            value.get_type().name()?
        ))),
    }
}

/// Reads a sequence of what stands for poses, such as an array of n x 4 x 4.
pub(crate) fn read_all(values: &Bound<'_, PyAny>) -> PyResult<Vec<api::Pose>> {
    values.try_iter()?.map(|value| read(&value?)).collect()
}

/// A position with a quaternion or a rotation of scipy.
fn pair(position: &Bound<'_, PyAny>, orientation: &Bound<'_, PyAny>) -> PyResult<api::Pose> {
    let position = position.extract::<[f64; 3]>()?;
    let quaternion = if orientation.hasattr("as_quat")? {
        orientation.call_method0("as_quat")?
    } else {
        orientation.clone()
    };
    let quaternion = quaternion.extract::<[f64; 4]>()?;
    let norm = quaternion.iter().map(|part| part * part).sum::<f64>();
    if !(norm > 0.0 && norm.is_finite()) {
        let text = format!("{quaternion:?} is no orientation: a quaternion is finite and not zero");
        return Err(error::invalid(orientation.py(), text));
    }
    Ok(api::Pose::quaternion(position, quaternion))
}

fn homogeneous(py: Python<'_>, rows: [[f64; 4]; 4]) -> PyResult<api::Pose> {
    let [first, second, third, last] = rows;
    let rotation = Matrix3::from_rows(&[first, second, third].map(|[a, b, c, _]| [a, b, c].into()));
    let off = (rotation * rotation.transpose() - Matrix3::identity()).norm();
    let is_rotation = off <= MATRIX_TOLERANCE && rotation.determinant() > 0.0;
    let ends = last
        .iter()
        .zip([0.0, 0.0, 0.0, 1.0])
        .all(|(a, b)| (a - b).abs() <= MATRIX_TOLERANCE);
    if !(is_rotation && ends) {
        let text = "the matrix is no pose: its upper left 3x3 block is a rotation, its last row 0, 0, 0, 1";
        return Err(error::invalid(py, text));
    }
    let rotation =
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    let [x, y, z] = [first, second, third].map(|[_, _, _, at]| at);
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), rotation).into())
}

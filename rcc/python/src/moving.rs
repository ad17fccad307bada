//! Frames that move while an arm follows them.

use pyo3::prelude::*;
use takt_api as api;

use crate::expression::Operand;
use crate::frame::Frame;
use crate::pose;

/// A frame that moves.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct MovingFrame(pub(crate) api::MovingFrame);

#[pymethods]
impl MovingFrame {
    /// The frame at three numbers, m, and turned by the next three, rad.
    #[staticmethod]
    #[pyo3(signature = (position, rotation=None))]
    fn of(
        py: Python<'_>,
        position: [Operand<'_>; 3],
        rotation: Option<[Operand<'_>; 3]>,
    ) -> PyResult<Self> {
        let [x, y, z] = position;
        let position = [x.number(py)?, y.number(py)?, z.number(py)?];
        let rotation = match rotation {
            None => [0.0, 0.0, 0.0].map(api::Number::from),
            Some([a, b, c]) => [a.number(py)?, b.number(py)?, c.number(py)?],
        };
        Ok(Self(api::MovingFrame::of(position, rotation)))
    }

    /// The frame of numbers that are given in a frame of the cell.
    fn in_(&self, frame: &Bound<'_, Frame>) -> Self {
        Self(self.0.clone().in_(&frame.get().0))
    }

    /// A pose that moves with the frame.
    fn pose(&self, pose: &Bound<'_, PyAny>) -> PyResult<Self> {
        Ok(Self(self.0.clone().pose(pose::read(pose)?)))
    }
}

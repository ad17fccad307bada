//! One step of all moving bodies: forces of springs and dampers taken at the end of the step (linearly implicit Euler),
//! so that stiff contact on light bodies neither rings nor gains energy. No contact detection.
//!
//! With `C = dt K + D` of each element, `(M + dt J' C J) v+ = M v + dt (weight + J' (f + C u))`, where `u` is the
//! prescribed velocity of the other side; its force is then `f - C (v+ - u)`. The matrix is symmetric and positive
//! definite, because elements give positive semidefinite `C` only: the decomposition exists.

use crate::geometry::{Twist, cross};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

type Matrix6 = SMatrix<f64, 6, 6>;
type Vector6 = SVector<f64, 6>;
type Matrix36 = SMatrix<f64, 3, 6>;

/// The other side of an element.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Against {
    /// Moves as prescribed.
    Prescribed(Twist),
    /// Another moving body, by its number among them, and from its centre of mass to the point.
    Body(usize, Vector3<f64>),
}

/// A spring and damper at a point of a body.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Element {
    /// The body, by its number among the moving ones.
    pub(crate) body: usize,
    /// From its centre of mass to the point, m.
    pub(crate) arm: Vector3<f64>,
    /// The other side; its twist is that of the point.
    pub(crate) against: Against,
    /// Force of the springs on the body, N.
    pub(crate) force: Vector3<f64>,
    /// Torque of the springs on the body, Nm.
    pub(crate) torque: Vector3<f64>,
    /// `dt K + D`, Ns/m.
    pub(crate) resistance: Matrix3<f64>,
    /// The same about the axes, Nms/rad.
    pub(crate) turn_resistance: Matrix3<f64>,
}

/// A moving body.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Mass {
    /// kg.
    pub(crate) mass: f64,
    /// In the axes of the world, kg m2.
    pub(crate) inertia: Matrix3<f64>,
    pub(crate) twist: Twist,
    /// Weight and gyroscopic torque about the centre of mass.
    pub(crate) weight: (Vector3<f64>, Vector3<f64>),
}

/// The equations, kept between the steps for their memory.
#[derive(Debug, Clone, Default)]
pub(crate) struct Solver {
    matrix: Vec<f64>,
    right: Vec<f64>,
}

fn lever(arm: &Vector3<f64>) -> Matrix36 {
    let mut jacobian = Matrix36::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    jacobian
        .fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&-cross(arm));
    jacobian
}

fn stacked(linear: &Vector3<f64>, angular: &Vector3<f64>) -> Vector6 {
    Vector6::new(
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
    )
}

impl Solver {
    /// Advances the twists of the masses by a step of `dt` seconds.
    pub(crate) fn step(&mut self, masses: &mut [Mass], elements: &[Element], dt: f64) {
        let size = masses.len() * 6;
        self.matrix.clear();
        self.matrix.resize(size * size, 0.0);
        self.right.clear();
        self.right.resize(size, 0.0);
        for (i, mass) in masses.iter().enumerate() {
            self.inertia(i, mass, size, dt);
        }
        for element in elements {
            self.element(element, size, dt);
        }
        if decompose(&mut self.matrix, size) {
            substitute(&self.matrix, &mut self.right, size);
            for (mass, [a, b, c, d, e, f]) in masses.iter_mut().zip(self.right.as_chunks::<6>().0) {
                let twist = Twist {
                    linear: Vector3::new(*a, *b, *c),
                    angular: Vector3::new(*d, *e, *f),
                };
                if twist.is_finite() {
                    mass.twist = twist;
                }
            }
        }
    }

    fn inertia(&mut self, i: usize, mass: &Mass, size: usize, dt: f64) {
        let mut block = Matrix6::zeros();
        block
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&(Matrix3::identity() * mass.mass));
        block.fixed_view_mut::<3, 3>(3, 3).copy_from(&mass.inertia);
        let momentum = block * stacked(&mass.twist.linear, &mass.twist.angular);
        let (force, torque) = mass.weight;
        self.add(i, i, size, &block);
        self.push(i, &(momentum + stacked(&force, &torque) * dt));
    }

    fn element(&mut self, element: &Element, size: usize, dt: f64) {
        let own = lever(&element.arm);
        let c = element.resistance;
        let mut block = own.transpose() * c * own;
        let mut corner = block.fixed_view_mut::<3, 3>(3, 3);
        corner += element.turn_resistance;
        let mut push = own.transpose() * element.force;
        add_torque(&mut push, &element.torque);
        self.add(element.body, element.body, size, &(block * dt));
        match element.against {
            Against::Prescribed(twist) => {
                push += own.transpose() * (c * twist.linear);
                add_torque(&mut push, &(element.turn_resistance * twist.angular));
            }
            Against::Body(other, arm) => {
                let its = lever(&arm);
                let mut block = its.transpose() * c * its;
                let mut corner = block.fixed_view_mut::<3, 3>(3, 3);
                corner += element.turn_resistance;
                self.add(other, other, size, &(block * dt));
                let mut block = own.transpose() * c * its;
                let mut corner = block.fixed_view_mut::<3, 3>(3, 3);
                corner += element.turn_resistance;
                self.add(element.body, other, size, &(block * -dt));
                self.add(other, element.body, size, &(block.transpose() * -dt));
                let mut back = its.transpose() * -element.force;
                add_torque(&mut back, &-element.torque);
                self.push(other, &(back * dt));
            }
        }
        self.push(element.body, &(push * dt));
    }

    fn add(&mut self, row: usize, column: usize, size: usize, block: &Matrix6) {
        for i in 0..6 {
            for j in 0..6 {
                if let Some(cell) = self.matrix.get_mut((row * 6 + i) * size + column * 6 + j) {
                    *cell += block[(i, j)];
                }
            }
        }
    }

    fn push(&mut self, row: usize, values: &Vector6) {
        for (i, value) in values.iter().enumerate() {
            if let Some(cell) = self.right.get_mut(row * 6 + i) {
                *cell += value;
            }
        }
    }
}

fn add_torque(wrench: &mut Vector6, torque: &Vector3<f64>) {
    for (i, value) in torque.iter().enumerate() {
        wrench[3 + i] += value;
    }
}

/// Force and torque of an element on its body at the end of a step.
pub(crate) fn reaction(element: &Element, masses: &[Mass]) -> (Vector3<f64>, Vector3<f64>) {
    let Some(own) = masses.get(element.body) else {
        return (Vector3::zeros(), Vector3::zeros());
    };
    let other = match element.against {
        Against::Prescribed(twist) => twist,
        Against::Body(other, arm) => {
            let twist = masses.get(other).map_or_else(Twist::default, |it| it.twist);
            Twist {
                linear: twist.at(&arm),
                angular: twist.angular,
            }
        }
    };
    let slide = own.twist.at(&element.arm) - other.linear;
    let turn = own.twist.angular - other.angular;
    (
        element.force - element.resistance * slide,
        element.torque - element.turn_resistance * turn,
    )
}

/// Cholesky decomposition in the lower triangle; false if the matrix is not positive definite.
fn decompose(matrix: &mut [f64], size: usize) -> bool {
    for column in 0..size {
        for row in column..size {
            let mut sum = matrix[row * size + column];
            for k in 0..column {
                sum -= matrix[row * size + k] * matrix[column * size + k];
            }
            if row == column {
                if sum.is_nan() || sum <= 0.0 {
                    return false;
                }
                matrix[row * size + column] = sum.sqrt();
            } else {
                matrix[row * size + column] = sum / matrix[column * size + column];
            }
        }
    }
    true
}

fn substitute(matrix: &[f64], right: &mut [f64], size: usize) {
    for row in 0..size {
        let mut sum = right[row];
        for k in 0..row {
            sum -= matrix[row * size + k] * right[k];
        }
        right[row] = sum / matrix[row * size + row];
    }
    for row in (0..size).rev() {
        let mut sum = right[row];
        for k in row + 1..size {
            sum -= matrix[k * size + row] * right[k];
        }
        right[row] = sum / matrix[row * size + row];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mass(speed: f64) -> Mass {
        Mass {
            mass: 2.0,
            inertia: Matrix3::identity() * 0.01,
            twist: Twist {
                linear: Vector3::x() * speed,
                angular: Vector3::zeros(),
            },
            weight: (Vector3::zeros(), Vector3::zeros()),
        }
    }

    #[test]
    fn solver_stiff_damper_keeps_momentum_of_two() {
        let mut masses = [mass(1.0), mass(0.0)];
        let element = Element {
            body: 0,
            arm: Vector3::zeros(),
            against: Against::Body(1, Vector3::zeros()),
            force: Vector3::zeros(),
            torque: Vector3::zeros(),
            resistance: Matrix3::identity() * 1e9,
            turn_resistance: Matrix3::zeros(),
        };
        Solver::default().step(&mut masses, &[element], 1e-3);
        for mass in masses {
            assert!((mass.twist.linear.x - 0.5).abs() < 1e-6, "{mass:?}");
        }
        // From 1 m/s to 0.5 m/s within 1 ms.
        let (force, _) = reaction(&element, &masses);
        assert!((force.x + 1000.0).abs() < 1.0, "{force}");
    }
}

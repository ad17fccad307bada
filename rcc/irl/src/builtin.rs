//! Predefined functions and operators on geometry: names and types for the compiler, one function for the interpreter. All
//! have bounded cost. Angles are degrees, lengths millimetres.

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use takt_net::Frame;

/// A predefined function. Types are named as in the language.
pub(crate) struct Signature {
    pub(crate) name: &'static str,
    pub(crate) arguments: &'static [&'static str],
    pub(crate) result: &'static str,
    run: Run,
}

/// Words of the largest result.
pub(crate) const RESULT_MAX: usize = 7;
/// The result of a function, from the first word on.
type Words = [u64; RESULT_MAX];
/// `None` where the function is not defined.
type Run = fn(&[u64]) -> Option<Words>;

const R: &str = "real";
const I: &str = "int";
const P: &str = "position";
const O: &str = "orientation";
const T: &str = "pose";

macro_rules! table {
    ($($name:literal ($($argument:expr),*) $result:ident = $run:expr;)*) => {
        &[$(Signature { name: $name, arguments: &[$($argument),*], result: $result, run: $run },)*]
    };
}

const C: &str = "char";

/// All of them. Their numbers are part of object code: new ones are added at the end.
pub(crate) const ALL: &[Signature] = table! {
    "sin"(R) R = |w| real1(w, |x| x.to_radians().sin());
    "cos"(R) R = |w| real1(w, |x| x.to_radians().cos());
    "tan"(R) R = |w| real1(w, |x| x.to_radians().tan());
    "asin"(R) R = |w| real1(w, |x| x.asin().to_degrees());
    "acos"(R) R = |w| real1(w, |x| x.acos().to_degrees());
    "atan"(R) R = |w| real1(w, |x| x.atan().to_degrees());
    "atan2"(R, R) R = |w| reals(&[number(w, 0).atan2(number(w, 1)).to_degrees()]);
    "sqrt"(R) R = |w| real1(w, f64::sqrt);
    "exp"(R) R = |w| real1(w, f64::exp);
    "ln"(R) R = |w| real1(w, f64::ln);
    "abs"(R) R = |w| real1(w, f64::abs);
    "abs"(I) I = |w| whole(int(w, 0).checked_abs()?);
    "trunc"(R) I = |w| to_int(number(w, 0).trunc());
    "round"(R) I = |w| to_int(number(w, 0).round());
    "float"(I) R = |w| reals(&[int(w, 0) as f64]);
    "ord"(C) I = |w| whole(int(w, 0));
    "chr"(I) C = |w| (0..=127).contains(&int(w, 0)).then(|| whole(int(w, 0)))?;
    "cross"(P, P) P = |w| vector(at(w, 0).cross(&at(w, 3)));
    "dot"(P, P) R = |w| reals(&[at(w, 0).dot(&at(w, 3))]);
    "length"(P) R = |w| reals(&[at(w, 0).norm()]);
    "orixyz"(R, R, R) O = |w| turned(&[(Vector3::x(), 0), (Vector3::y(), 1), (Vector3::z(), 2)], w);
    "oriyxz"(R, R, R) O = |w| turned(&[(Vector3::y(), 0), (Vector3::x(), 1), (Vector3::z(), 2)], w);
    "orizyx"(R, R, R) O = |w| turned(&[(Vector3::z(), 0), (Vector3::y(), 1), (Vector3::x(), 2)], w);
    "orivang"(P, R) O = |w| {
        let axis = nalgebra::Unit::try_new(at(w, 0), 1e-12)?;
        rotation(UnitQuaternion::from_axis_angle(&axis, number(w, 3).to_radians()))
    };
    "oriquat"(R, R, R, R) O = |w| rotation(orientation(w, 0)?);
    "orimult"(O, O) O = |w| rotation(orientation(w, 0)? * orientation(w, 4)?);
    "orimat"(P, P, P) O = |w| {
        let matrix = Matrix3::from_columns(&[at(w, 0), at(w, 3), at(w, 6)]);
        let is_rotation = (matrix.determinant() - 1.0).abs() < 1e-6
            && (matrix * matrix.transpose() - Matrix3::identity()).norm() < 1e-6;
        let matrix = Rotation3::from_matrix_unchecked(matrix);
        is_rotation.then(|| rotation(UnitQuaternion::from_rotation_matrix(&matrix)))?
    };
    "vectorn"(O) P = |w| vector(orientation(w, 0)? * Vector3::x());
    "vectoro"(O) P = |w| vector(orientation(w, 0)? * Vector3::y());
    "vectora"(O) P = |w| vector(orientation(w, 0)? * Vector3::z());
    "anglex"(O) R = |w| angle(w, 0);
    "angley"(O) R = |w| angle(w, 1);
    "anglez"(O) R = |w| angle(w, 2);
    "inv"(T) T = |w| pose_words(&frame_mm(w, 0)?.inverse());
    "pose @ pose"(T, T) T = |w| pose_words(&(frame_mm(w, 0)? * frame_mm(w, 7)?));
    "pose @ position"(T, P) P = |w| {
        let frame = frame_mm(w, 0)?;
        vector(frame.rotation * at(w, 7) + frame.translation.vector)
    };
    "position + position"(P, P) P = |w| vector(at(w, 0) + at(w, 3));
    "position - position"(P, P) P = |w| vector(at(w, 0) - at(w, 3));
    "position * real"(P, R) P = |w| vector(at(w, 0) * number(w, 3));
    "- position"(P) P = |w| vector(-at(w, 0));
};

pub(crate) fn name(number: u32) -> &'static str {
    ALL.get(number as usize).map_or("?", |s| s.name)
}

/// Words of a value of a type in this table.
pub(crate) fn words_of(ty: &str) -> usize {
    match ty {
        P => 3,
        O => 4,
        T => 7,
        _ => 1,
    }
}

/// Runs a function on its arguments; `None` if it does not exist or is not defined for them.
pub(crate) fn run(number: u32, arguments: &[u64]) -> Option<(Words, usize)> {
    let signature = ALL.get(number as usize)?;
    let words = (signature.run)(arguments)?;
    Some((words, words_of(signature.result)))
}

/// Number of words of the arguments of a function.
pub(crate) fn argument_words(number: u32) -> Option<usize> {
    let signature = ALL.get(number as usize)?;
    Some(signature.arguments.iter().map(|ty| words_of(ty)).sum())
}

fn number(words: &[u64], at: usize) -> f64 {
    words.get(at).map_or(f64::NAN, |word| f64::from_bits(*word))
}

fn int(words: &[u64], at: usize) -> i64 {
    words.get(at).map_or(0, |word| word.cast_signed())
}

fn whole(value: i64) -> Option<Words> {
    i32::try_from(value).ok()?;
    let mut words = [0; RESULT_MAX];
    words[0] = value.cast_unsigned();
    Some(words)
}

fn to_int(value: f64) -> Option<Words> {
    let fits = (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&value);
    #[expect(clippy::cast_possible_truncation, reason = "checked to be in range")]
    fits.then(|| whole(value as i64))?
}

fn reals(values: &[f64]) -> Option<Words> {
    let mut words = [0; RESULT_MAX];
    for (word, value) in words.iter_mut().zip(values) {
        *word = value.is_finite().then(|| value.to_bits())?;
    }
    Some(words)
}

fn real1(words: &[u64], function: fn(f64) -> f64) -> Option<Words> {
    reals(&[function(number(words, 0))])
}

fn at(words: &[u64], first: usize) -> Vector3<f64> {
    Vector3::from_fn(|i, _| number(words, first + i))
}

fn vector(value: Vector3<f64>) -> Option<Words> {
    reals(value.as_slice())
}

fn orientation(words: &[u64], first: usize) -> Option<UnitQuaternion<f64>> {
    let [w, x, y, z] = [0, 1, 2, 3].map(|i| number(words, first + i));
    UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-9)
}

fn rotation(value: UnitQuaternion<f64>) -> Option<Words> {
    reals(&[value.w, value.i, value.j, value.k])
}

fn turned(axes: &[(Vector3<f64>, usize); 3], words: &[u64]) -> Option<Words> {
    let turn = |(axis, i): &(Vector3<f64>, usize)| {
        UnitQuaternion::from_scaled_axis(axis * number(words, *i).to_radians())
    };
    let [a, b, c] = axes;
    rotation(turn(a) * turn(b) * turn(c))
}

/// An angle of rotations about z, then the new y, then the new x.
fn angle(words: &[u64], axis: usize) -> Option<Words> {
    let (x, y, z) = orientation(words, 0)?.euler_angles();
    reals(&[[x, y, z].get(axis)?.to_degrees()])
}

/// A pose as a frame whose lengths are mm.
fn frame_mm(words: &[u64], first: usize) -> Option<Frame> {
    Some(Frame::from_parts(
        at(words, first).into(),
        orientation(words, first + 3)?,
    ))
}

fn pose_words(frame: &Frame) -> Option<Words> {
    let (p, q) = (frame.translation.vector, frame.rotation);
    reals(&[p.x, p.y, p.z, q.w, q.i, q.j, q.k])
}

/// A pose in memory as a frame, m.
pub(crate) fn frame(words: &[u64]) -> Option<Frame> {
    let mut frame = frame_mm(words, 0)?;
    frame.translation.vector /= 1000.0;
    let finite = frame.translation.vector.iter().all(|v| v.is_finite());
    finite.then_some(frame)
}

/// A frame (m) as the words of a pose.
pub(crate) fn of_frame(frame: &Frame) -> Option<Words> {
    let mut frame = *frame;
    frame.translation.vector *= 1000.0;
    pose_words(&frame)
}

/// Six numbers of a specification (mm and deg about z, y, x) as a frame, m.
pub(crate) fn of_six(values: &[f64; 6]) -> Frame {
    let [x, y, z, a, b, c] = *values;
    let turn = UnitQuaternion::from_euler_angles(c.to_radians(), b.to_radians(), a.to_radians());
    let position = Vector3::new(x, y, z) / 1000.0;
    Frame::from_parts(position.into(), turn)
}

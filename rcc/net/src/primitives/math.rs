//! Arithmetic. An undefined result is the IEEE 754 result for doubles and null for integers, never
//! a panic.

use crate::definition::{Definition, Port, function, port};

const VALUE: &[(&str, &str)] = &[("outValue", "result")];

const fn operands(default: &'static str) -> [Port; 2] {
    [
        port("inFirst", "first operand").or("First", default),
        port("inSecond", "second operand").or("Second", default),
    ]
}

fn double1(
    name: &str,
    doc: &'static str,
    operand: Port,
    f: impl Fn(f64) -> f64 + Copy + Send + Sync + 'static,
) -> Definition {
    function(name, doc, &[operand], VALUE, move |(a,): (f64,)| {
        Some((f(a),))
    })
}

fn double2(
    name: &str,
    doc: &'static str,
    operands: [Port; 2],
    f: impl Fn(f64, f64) -> f64 + Copy + Send + Sync + 'static,
) -> Definition {
    function(name, doc, &operands, VALUE, move |(a, b): (f64, f64)| {
        Some((f(a, b),))
    })
}

fn int1(
    name: &str,
    doc: &'static str,
    f: impl Fn(i32) -> Option<i32> + Copy + Send + Sync + 'static,
) -> Definition {
    function(name, doc, &[number("0")], VALUE, move |(a,): (i32,)| {
        Some((f(a)?,))
    })
}

fn int2(
    name: &str,
    doc: &'static str,
    f: impl Fn(i32, i32) -> Option<i32> + Copy + Send + Sync + 'static,
) -> Definition {
    function(
        name,
        doc,
        &operands("0"),
        VALUE,
        move |(a, b): (i32, i32)| Some((f(a, b)?,)),
    )
}

const fn number(default: &'static str) -> Port {
    port("inValue", "operand").or("Value", default)
}

pub(super) fn table() -> Vec<Definition> {
    let tables = [doubles(), signs(), angles(), whole_numbers()];
    tables.into_iter().flatten().collect()
}

/// The smaller of two numbers, not a number if one of them is not: a broken value must not vanish.
fn least(a: f64, b: f64) -> f64 {
    if a.is_nan() || a < b { a } else { b }
}

fn greatest(a: f64, b: f64) -> f64 {
    -least(-a, -b)
}

fn signs() -> Vec<Definition> {
    vec![
        double1(
            "Core::DoubleNegate",
            "Minus the number.",
            number("0"),
            |a| -a,
        ),
        double1(
            "Core::DoubleAbs",
            "The number without its sign.",
            number("0"),
            f64::abs,
        ),
        double1(
            "Core::DoubleSign",
            "-1, 0 or 1: the sign of the number; not a number of such.",
            number("0"),
            |a| if a == 0.0 { 0.0 } else { a.signum() },
        ),
        double2(
            "Core::DoubleMin",
            "The smaller of two numbers; not a number if one of them is not.",
            operands("0"),
            least,
        ),
        double2(
            "Core::DoubleMax",
            "The greater of two numbers; not a number if one of them is not.",
            operands("0"),
            greatest,
        ),
    ]
}

fn doubles() -> Vec<Definition> {
    vec![
        double2(
            "Core::DoubleAdd",
            "First plus second.",
            operands("0"),
            |a, b| a + b,
        ),
        double2(
            "Core::DoubleSubtract",
            "First minus second.",
            operands("0"),
            |a, b| a - b,
        ),
        double2(
            "Core::DoubleMultiply",
            "First times second.",
            operands("0"),
            |a, b| a * b,
        ),
        double2(
            "Core::DoubleDivide",
            "First divided by second.",
            operands("0"),
            |a, b| a / b,
        ),
        double2(
            "Core::DoubleModulo",
            "Remainder of first divided by second, with the sign of first.",
            operands("1"),
            |a, b| a % b,
        ),
        double2(
            "Core::DoublePower",
            "First to the power of second.",
            operands("0"),
            f64::powf,
        ),
        double1(
            "Core::DoubleSquareRoot",
            "Square root.",
            number("1"),
            f64::sqrt,
        ),
        double1(
            "Core::DoubleLog",
            "Natural logarithm.",
            number("0"),
            f64::ln,
        ),
    ]
}

fn angles() -> Vec<Definition> {
    let angle = port("inValue", "angle, rad").or("Value", "1");
    let atan2 = [
        port("inY", "opposite side").or("Y", "1"),
        port("inX", "adjacent side").or("X", "1"),
    ];
    vec![
        double2(
            "Core::DoubleAtan2",
            "Angle of the point (X, Y), rad.",
            atan2,
            f64::atan2,
        ),
        double1("Core::DoubleSin", "Sine.", angle, f64::sin),
        double1("Core::DoubleCos", "Cosine.", angle, f64::cos),
        double1("Core::DoubleTan", "Tangent.", angle, f64::tan),
        double1("Core::DoubleAsin", "Arc sine, rad.", number("1"), f64::asin),
        double1(
            "Core::DoubleAcos",
            "Arc cosine, rad.",
            number("1"),
            f64::acos,
        ),
    ]
}

fn whole_numbers() -> Vec<Definition> {
    vec![
        int2(
            "Core::IntAdd",
            "First plus second; null on overflow.",
            i32::checked_add,
        ),
        int2(
            "Core::IntSubtract",
            "First minus second; null on overflow.",
            i32::checked_sub,
        ),
        int1(
            "Core::IntNegate",
            "Minus the number; null on overflow.",
            i32::checked_neg,
        ),
        int1(
            "Core::IntAbs",
            "The number without its sign; null on overflow.",
            i32::checked_abs,
        ),
        int1(
            "Core::IntSign",
            "-1, 0 or 1: the sign of the number.",
            |a| Some(a.signum()),
        ),
        int2("Core::IntMin", "The smaller of two numbers.", |a, b| {
            Some(a.min(b))
        }),
        int2("Core::IntMax", "The greater of two numbers.", |a, b| {
            Some(a.max(b))
        }),
        int2(
            "Core::IntMultiply",
            "First times second; null on overflow.",
            i32::checked_mul,
        ),
        int2(
            "Core::IntDivide",
            "Whole part of first divided by second; null by zero.",
            i32::checked_div,
        ),
        function(
            "Core::DoubleFromInt",
            "The same number as a double.",
            &[number("1")],
            VALUE,
            |(a,): (i32,)| Some((f64::from(a),)),
        ),
        function(
            "Core::IntFromDouble",
            "The number without its fraction; null if it does not fit.",
            &[number("1")],
            VALUE,
            |(a,): (f64,)| Some((whole(a)?,)),
        ),
    ]
}

fn whole(value: f64) -> Option<i32> {
    let fits = value.trunc() >= f64::from(i32::MIN) && value.trunc() <= f64::from(i32::MAX);
    #[expect(clippy::cast_possible_truncation, reason = "just checked")]
    fits.then_some(value as i32)
}

#[cfg(test)]
mod tests {
    use super::whole;

    #[test]
    fn whole_numbers() {
        assert_eq!(whole(-2.9), Some(-2));
        assert_eq!(whole(2_147_483_647.5), Some(i32::MAX));
        assert_eq!(whole(2_147_483_648.0), None);
        assert_eq!(whole(f64::NAN), None);
    }
}

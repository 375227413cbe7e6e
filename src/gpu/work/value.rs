//! Numbers of a program as far as they are known without its data, and what operators make of them.

use naga::{BinaryOperator, Handle, Literal, ScalarKind, Type, UnaryOperator};

/// A number as far as it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Number {
    Float,
    Unsigned(Option<u32>),
    Signed(Option<i32>),
    Truth(Option<bool>),
}

impl Number {
    /// Returns an unknown number of this kind.
    pub fn of(kind: ScalarKind) -> Self {
        match kind {
            ScalarKind::Uint => Self::Unsigned(None),
            ScalarKind::Sint => Self::Signed(None),
            ScalarKind::Bool => Self::Truth(None),
            _ => Self::Float,
        }
    }

    pub fn zero(self) -> Self {
        match self {
            Self::Float => Self::Float,
            Self::Unsigned(_) => Self::Unsigned(Some(0)),
            Self::Signed(_) => Self::Signed(Some(0)),
            Self::Truth(_) => Self::Truth(Some(false)),
        }
    }

    pub fn unknown(self) -> Self {
        match self {
            Self::Float => Self::Float,
            Self::Unsigned(_) => Self::Unsigned(None),
            Self::Signed(_) => Self::Signed(None),
            Self::Truth(_) => Self::Truth(None),
        }
    }

    /// Returns a known whole number or truth.
    pub fn whole(self) -> Option<i64> {
        match self {
            Self::Float => None,
            Self::Unsigned(v) => v.map(i64::from),
            Self::Signed(v) => v.map(i64::from),
            Self::Truth(v) => v.map(i64::from),
        }
    }

    /// Returns this whole number as one of the kind of `self`.
    pub fn with(self, value: i64) -> Self {
        match self {
            Self::Float => Self::Float,
            Self::Unsigned(_) => Self::Unsigned(Some(value as u32)),
            Self::Signed(_) => Self::Signed(Some(value as i32)),
            Self::Truth(_) => Self::Truth(Some(value != 0)),
        }
    }
}

/// How the numbers of a value, or of what a place holds, are arranged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    Scalar(Number),
    Vector(usize, Number),
    /// Columns, rows.
    Matrix(usize, usize),
    /// A struct or an array.
    Of(Handle<Type>),
}

/// The numbers of an expression, and when they are there.
#[derive(Clone, Debug)]
pub struct Value {
    pub shape: Shape,
    pub numbers: Vec<Number>,
    /// The cycle from which on it may be used.
    pub ready: f64,
    /// Whether it may differ between lanes.
    pub varies: bool,
}

impl Value {
    pub fn scalar(number: Number) -> Self {
        Self { shape: Shape::Scalar(number.unknown()), numbers: vec![number], ready: 0.0, varies: false }
    }

    pub fn literal(literal: Literal) -> Self {
        Self::scalar(match literal {
            Literal::U32(v) => Number::Unsigned(Some(v)),
            Literal::I32(v) => Number::Signed(Some(v)),
            Literal::AbstractInt(v) => Number::Signed(Some(v as i32)),
            Literal::Bool(v) => Number::Truth(Some(v)),
            _ => Number::Float,
        })
    }

    pub fn composed(shape: Shape, parts: impl Iterator<Item = Self>) -> Self {
        let mut all = Self { shape, numbers: Vec::new(), ready: 0.0, varies: false };
        for part in parts {
            all.numbers.extend(part.numbers);
            all.ready = all.ready.max(part.ready);
            all.varies |= part.varies;
        }
        all
    }

    pub fn splat(size: usize, value: &Self) -> Self {
        let shape = Shape::Vector(size, value.numbers[0].unknown());
        Self { shape, numbers: vec![value.numbers[0]; size], ..value.clone() }
    }

    pub fn unary(op: UnaryOperator, value: &Self) -> Self {
        let of = |number: &Number| match (op, number.whole()) {
            (_, None) => *number,
            (UnaryOperator::Negate, Some(v)) => number.with(-v),
            (UnaryOperator::LogicalNot, Some(v)) => number.with(i64::from(v == 0)),
            (UnaryOperator::BitwiseNot, Some(v)) => number.with(!v),
        };
        Self { numbers: value.numbers.iter().map(of).collect(), ..value.clone() }
    }

    /// Returns the result of an operator, as soon as its operands are there.
    pub fn combined(op: BinaryOperator, left: &Self, right: &Self) -> Self {
        use BinaryOperator as Op;
        let compares = matches!(
            op,
            Op::Equal | Op::NotEqual | Op::Less | Op::LessEqual | Op::Greater | Op::GreaterEqual
        );
        let count = left.numbers.len().max(right.numbers.len());
        let pick = |value: &Self, k: usize| value.numbers[k % value.numbers.len()];
        let of = |k: usize| {
            let (a, b) = (pick(left, k), pick(right, k));
            let kind = if compares { Number::Truth(None) } else { a.unknown() };
            let (known_a, known_b) = (a.whole(), b.whole());
            // What one operand decides.
            match (op, known_a, known_b) {
                (Op::LogicalAnd | Op::And, Some(0), _) | (Op::LogicalAnd | Op::And, _, Some(0)) => {
                    return kind.with(0);
                }
                (Op::LogicalOr, Some(1), _) | (Op::LogicalOr, _, Some(1)) => return kind.with(1),
                _ => {}
            }
            let (Some(a), Some(b)) = (known_a, known_b) else { return kind };
            kind.with(match op {
                Op::Add => a + b,
                Op::Subtract => a - b,
                Op::Multiply => a.wrapping_mul(b),
                Op::Divide => a.checked_div(b).unwrap_or(0),
                Op::Modulo => a.checked_rem(b).unwrap_or(0),
                Op::Equal => i64::from(a == b),
                Op::NotEqual => i64::from(a != b),
                Op::Less => i64::from(a < b),
                Op::LessEqual => i64::from(a <= b),
                Op::Greater => i64::from(a > b),
                Op::GreaterEqual => i64::from(a >= b),
                Op::And | Op::LogicalAnd => a & b,
                Op::ExclusiveOr => a ^ b,
                Op::InclusiveOr | Op::LogicalOr => a | b,
                Op::ShiftLeft => a << (b & 31),
                Op::ShiftRight => a >> (b & 31),
            })
        };
        let numbers: Vec<_> = (0..count).map(of).collect();
        let shape = match (left.shape, right.shape) {
            // A matrix times a vector, or the other way round.
            (Shape::Matrix(_, rows), Shape::Vector(..)) if op == Op::Multiply => {
                Shape::Vector(rows, Number::Float)
            }
            (Shape::Vector(..), Shape::Matrix(columns, _)) if op == Op::Multiply => {
                Shape::Vector(columns, Number::Float)
            }
            (Shape::Matrix(_, rows), Shape::Matrix(columns, _)) if op == Op::Multiply => {
                Shape::Matrix(columns, rows)
            }
            (Shape::Scalar(_), shape) | (shape, _) => match shape {
                Shape::Scalar(_) => Shape::Scalar(numbers[0].unknown()),
                Shape::Vector(size, _) => Shape::Vector(size, numbers[0].unknown()),
                other => other,
            },
        };
        let numbers = match shape {
            Shape::Vector(size, Number::Float) => vec![Number::Float; size],
            Shape::Matrix(columns, rows) => vec![Number::Float; columns * rows],
            _ => numbers,
        };
        let ready = left.ready.max(right.ready);
        Self { shape, numbers, ready, varies: left.varies || right.varies }
    }

    pub fn is_float(&self) -> bool {
        self.numbers.first() == Some(&Number::Float)
    }
}

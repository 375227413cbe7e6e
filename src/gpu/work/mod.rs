//! What a dispatch does, counted by walking through its program without its data.
//!
//! The walk follows the first invocation of a workgroup in the middle. It knows the parameters and constants of the dispatch,
//! and so how often its loops turn; what comes from memory it does not know. Where that decides, both branches of an `if` are taken, as a group
//! of lanes in lockstep does, and a loop turns [`DOUBTFUL_TURNS`] times.
//!
//! Instructions start in the order of the program, one in a cycle, each as soon as its operands are there. So loads that follow each other are
//! under way together, and the first use of one waits for it, as on a processor of a GPU. Stores do not wait, but the next barrier waits for
//! them: compilers load what the next turns of a loop store before they store that of the first. Other loops they may turn better than this, too.

mod value;

use naga::{
    AddressSpace, BinaryOperator, Block, BuiltIn, Expression, Function, GlobalVariable, Handle,
    LocalVariable, MathFunction, Module, Statement, SwitchCase, SwitchValue, Type, TypeInner,
};
use std::collections::HashMap;
use value::{Number, Shape, Value};

/// Turns of a loop whose end depends on data.
const DOUBTFUL_TURNS: usize = 2;
/// Most turns of any loop; none of this crate's has as many.
const MOST_TURNS: usize = 1 << 20;
/// Lanes that share an instruction, a warp.
pub(super) const WARP: u32 = 32;

/// Cycles until the result of an instruction may be used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Latencies {
    /// Of a load through the second cache.
    pub memory: f64,
    /// Of a load from workgroup memory, and of a barrier.
    pub workgroup: f64,
    /// Of any other instruction.
    pub arithmetic: f64,
}

/// The work of a dispatch. What is said of an invocation is meant for each of them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Work {
    /// Workgroups.
    pub groups: u64,
    /// Invocations of a workgroup.
    pub invocations: u32,
    /// Workgroup memory \[bytes\].
    pub workgroup_memory: u64,
    /// Cycles from the first to the last instruction of an invocation that has a processor for itself.
    pub cycles: f64,
    /// Instructions of an invocation.
    pub instructions: f64,
    /// Floating-point operations of an invocation.
    pub operations: f64,
    /// Bytes of an invocation from and to memory. What all lanes read alike counts once for them.
    pub memory_bytes: f64,
    /// Bytes of an invocation from and to workgroup memory, counted alike.
    pub workgroup_bytes: f64,
}

/// What is walked through.
pub(super) struct Walked<'a> {
    pub module: &'a Module,
    pub constants: &'a [(&'static str, f64)],
    /// Bytes of the uniform.
    pub params: &'a [u8],
    pub groups: [u32; 3],
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Space {
    Local(Handle<LocalVariable>),
    Private(Handle<GlobalVariable>),
    Workgroup,
    Uniform,
    Memory,
}

/// What a pointer points at.
#[derive(Clone, Debug)]
struct Place {
    space: Space,
    shape: Shape,
    /// Numbers and bytes from the begin of the variable, if known.
    at: Option<usize>,
    bytes: Option<usize>,
    ready: f64,
    varies: bool,
}

#[derive(Clone, Debug)]
enum Item {
    Value(Value),
    Place(Place),
}

/// A variable that lives in registers.
#[derive(Clone, Debug)]
struct Variable {
    numbers: Vec<Number>,
    ready: f64,
    varies: bool,
}

struct Frame<'a> {
    function: &'a Function,
    items: Vec<Option<Item>>,
    arguments: Vec<Item>,
    locals: HashMap<Handle<LocalVariable>, Variable>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Flow {
    Next,
    Break,
    Continue,
    Return,
}

struct Walk<'a> {
    of: &'a Walked<'a>,
    latencies: Latencies,
    size: [u32; 3],
    private: HashMap<Handle<GlobalVariable>, Variable>,
    clock: f64,
    /// When the last store has what it stores.
    stored: f64,
    work: Work,
    /// Whether data decided about leaving the loop in this turn.
    doubtful: bool,
    returned: Option<Value>,
}

/// Walks through a program.
pub(super) fn work(of: &Walked<'_>, latencies: Latencies) -> Work {
    let mut walk = Walk {
        of,
        latencies,
        size: [1; 3],
        private: HashMap::new(),
        clock: 0.0,
        stored: 0.0,
        work: Work::default(),
        doubtful: false,
        returned: None,
    };
    let entry = &of.module.entry_points[0];
    let given = entry.workgroup_size_overrides.unwrap_or_default();
    walk.size = [0, 1, 2].map(|axis| {
        let known = given[axis].and_then(|given| walk.global(given).numbers[0].whole());
        known.map_or(entry.workgroup_size[axis], |known| known as u32)
    });
    let of_workgroup = |(_, v): (_, &GlobalVariable)| (v.space == AddressSpace::WorkGroup).then_some(v.ty);
    let memory = of.module.global_variables.iter().filter_map(of_workgroup).map(|ty| walk.bytes_of(ty)).sum();
    walk.work = Work {
        groups: of.groups.iter().map(|&g| u64::from(g)).product(),
        invocations: walk.size.iter().product(),
        workgroup_memory: memory,
        ..Work::default()
    };
    let arguments = entry.function.arguments.iter().map(|a| walk.builtin(a)).collect();
    walk.call(&entry.function, arguments);
    Work { cycles: walk.clock.max(walk.stored), ..walk.work }
}

impl<'a> Walk<'a> {
    fn inner(&self, ty: Handle<Type>) -> &'a TypeInner {
        &self.of.module.types[ty].inner
    }

    fn shape(&self, ty: Handle<Type>) -> Shape {
        match *self.inner(ty) {
            TypeInner::Scalar(scalar) | TypeInner::Atomic(scalar) => Shape::Scalar(Number::of(scalar.kind)),
            TypeInner::Vector { size, scalar } => Shape::Vector(size as usize, Number::of(scalar.kind)),
            TypeInner::Matrix { columns, rows, .. } => Shape::Matrix(columns as usize, rows as usize),
            _ => Shape::Of(ty),
        }
    }

    /// Returns the elements of an array, 0 if only its buffer says how many there are.
    fn length(&self, size: naga::ArraySize) -> usize {
        match size {
            naga::ArraySize::Constant(length) => length.get() as usize,
            naga::ArraySize::Pending(length) => self.given(length).numbers[0].whole().unwrap_or(0) as usize,
            naga::ArraySize::Dynamic => 0,
        }
    }

    /// Returns the numbers in a value of this shape, unknown.
    fn blank(&self, shape: Shape) -> Vec<Number> {
        match shape {
            Shape::Scalar(number) => vec![number],
            Shape::Vector(size, number) => vec![number; size],
            Shape::Matrix(columns, rows) => vec![Number::Float; columns * rows],
            Shape::Of(ty) => match self.inner(ty) {
                TypeInner::Struct { members, .. } => {
                    members.iter().flat_map(|m| self.blank(self.shape(m.ty))).collect()
                }
                &TypeInner::Array { base, size, .. } => {
                    let one = self.blank(self.shape(base));
                    one.repeat(self.length(size))
                }
                _ => Vec::new(),
            },
        }
    }

    fn bytes_of(&self, ty: Handle<Type>) -> u64 {
        match *self.inner(ty) {
            TypeInner::Array { size, stride, .. } => self.length(size) as u64 * u64::from(stride),
            ref inner => u64::from(inner.try_size(self.of.module.to_ctx()).unwrap_or(0)),
        }
    }

    /// Returns a built-in value of the first invocation of the workgroup in the middle.
    fn builtin(&self, argument: &naga::FunctionArgument) -> Item {
        let Some(naga::Binding::BuiltIn(builtin)) = argument.binding else {
            unreachable!("kernels take built-ins")
        };
        let middle = self.of.groups.map(|g| g / 2);
        let (values, varies) = match builtin {
            BuiltIn::WorkGroupId => (middle.to_vec(), false),
            BuiltIn::NumWorkGroups => (self.of.groups.to_vec(), false),
            BuiltIn::LocalInvocationId => (vec![0; 3], true),
            BuiltIn::GlobalInvocationId => {
                (middle.iter().zip(self.size).map(|(&group, size)| group * size).collect(), true)
            }
            BuiltIn::SubgroupSize => (vec![WARP], false),
            _ => (vec![0], true),
        };
        let numbers: Vec<_> = values.into_iter().map(|v| Number::Unsigned(Some(v))).collect();
        Item::Value(Value { shape: self.shape(argument.ty), numbers, ready: 0.0, varies })
    }

    /// Returns the value of an override.
    fn given(&self, constant: Handle<naga::Override>) -> Value {
        let constant = &self.of.module.overrides[constant];
        let name = constant.name.as_deref().unwrap_or_default();
        match self.of.constants.iter().find(|(known, _)| *known == name) {
            Some(&(_, value)) => {
                let Shape::Scalar(kind) = self.shape(constant.ty) else {
                    unreachable!("overrides are scalars")
                };
                Value::scalar(kind.with(value as i64))
            }
            None => {
                self.global(constant.init.expect("the host gives every override without a value of its own"))
            }
        }
    }

    /// Returns a constant expression.
    fn global(&self, expression: Handle<Expression>) -> Value {
        match self.of.module.global_expressions[expression] {
            Expression::Literal(literal) => Value::literal(literal),
            Expression::Constant(constant) => self.global(self.of.module.constants[constant].init),
            Expression::Override(constant) => self.given(constant),
            Expression::ZeroValue(ty) => self.zero(ty),
            Expression::Compose { ty, ref components } => {
                Value::composed(self.shape(ty), components.iter().map(|&c| self.global(c)))
            }
            Expression::Splat { size, value } => Value::splat(size as usize, &self.global(value)),
            Expression::Unary { op, expr } => Value::unary(op, &self.global(expr)),
            Expression::Binary { op, left, right } => {
                let (left, right) = (self.global(left), self.global(right));
                Value::combined(op, &left, &right)
            }
            _ => Value::scalar(Number::Float),
        }
    }

    fn zero(&self, ty: Handle<Type>) -> Value {
        let shape = self.shape(ty);
        let numbers = self.blank(shape).into_iter().map(Number::zero).collect();
        Value { shape, numbers, ready: 0.0, varies: false }
    }

    /// Starts `count` instructions whose operands are there at `ready`. Returns when the result of the last one is.
    fn issue(&mut self, count: f64, latency: f64, ready: f64) -> f64 {
        let start = self.clock.max(ready);
        self.clock = start + count;
        self.work.instructions += count;
        start + count.max(1.0) - 1.0 + latency
    }

    /// Charges an operation of this many instructions. Addresses and conditions that are known run beside the rest: compilers
    /// take most of them out of loops.
    fn charge(&mut self, mut result: Value, per_number: f64, operations: f64) -> Value {
        let known = result.numbers.iter().all(|number| number.whole().is_some());
        if known {
            self.work.instructions += 0.25;
            self.clock += 0.25;
            return result;
        }
        let count = per_number * result.numbers.len() as f64;
        self.work.operations += operations * result.numbers.len() as f64;
        result.ready = self.issue(count, self.latencies.arithmetic, result.ready);
        result
    }

    fn call(&mut self, function: &'a Function, arguments: Vec<Item>) -> Option<Value> {
        let mut locals = HashMap::new();
        for (handle, variable) in function.local_variables.iter() {
            let numbers = self.blank(self.shape(variable.ty)).into_iter().map(Number::zero).collect();
            locals.insert(handle, Variable { numbers, ready: 0.0, varies: false });
        }
        let mut frame = Frame { function, items: vec![None; function.expressions.len()], arguments, locals };
        for (handle, variable) in function.local_variables.iter() {
            if let Some(init) = variable.init {
                let value = self.value(&mut frame, init);
                frame.locals.insert(
                    handle,
                    Variable { numbers: value.numbers, ready: value.ready, varies: value.varies },
                );
            }
        }
        self.returned = None;
        self.block(&mut frame, &function.body);
        self.returned.take()
    }

    fn block(&mut self, frame: &mut Frame<'a>, block: &'a Block) -> Flow {
        for statement in block {
            let flow = self.statement(frame, statement);
            if flow != Flow::Next {
                return flow;
            }
        }
        Flow::Next
    }

    fn statement(&mut self, frame: &mut Frame<'a>, statement: &'a Statement) -> Flow {
        match statement {
            Statement::Emit(range) => {
                for expression in range.clone() {
                    let item = self.compute(frame, expression);
                    frame.items[expression.index()] = Some(item);
                }
            }
            Statement::Block(block) => return self.block(frame, block),
            Statement::If { condition, accept, reject } => {
                return self.branch(frame, *condition, [accept, reject]);
            }
            Statement::Switch { selector, cases } => {
                let selector = self.value(frame, *selector);
                let flow = match selector.numbers[0].whole() {
                    Some(wanted) => self.case(frame, cases, wanted),
                    // What is data may differ from one lane to the next: all cases, as with `branch`.
                    None => {
                        self.issue(1.0, 0.0, selector.ready);
                        let flows: Vec<_> = cases.iter().map(|case| self.block(frame, &case.body)).collect();
                        if flows.iter().all(|flow| *flow == flows[0]) { flows[0] } else { Flow::Next }
                    }
                };
                return if flow == Flow::Break { Flow::Next } else { flow };
            }
            Statement::Loop { body, continuing, break_if } => {
                return self.turns(frame, [body, continuing], *break_if);
            }
            Statement::Break => return Flow::Break,
            Statement::Continue => return Flow::Continue,
            Statement::Return { value } => {
                self.returned = value.map(|value| self.value(frame, value));
                return Flow::Return;
            }
            Statement::ControlBarrier(_) => {
                self.issue(1.0, 0.0, self.stored);
                self.clock += self.latencies.workgroup;
            }
            Statement::Store { pointer, value } => {
                let (place, value) = (self.place(frame, *pointer), self.value(frame, *value));
                self.store(frame, &place, value);
            }
            Statement::ImageStore { value, .. } => {
                self.stored = self.stored.max(self.value(frame, *value).ready);
                self.issue(1.0, 0.0, 0.0);
                self.work.memory_bytes += 16.0;
            }
            Statement::Atomic { pointer, result, .. } => {
                let place = self.place(frame, *pointer);
                let value = self.load(frame, &place);
                if let Some(result) = result {
                    frame.items[result.index()] = Some(Item::Value(value));
                }
            }
            Statement::WorkGroupUniformLoad { pointer, result } => {
                let place = self.place(frame, *pointer);
                let value = self.load(frame, &place);
                frame.items[result.index()] = Some(Item::Value(value));
            }
            Statement::Call { function, arguments, result } => {
                let arguments = arguments.iter().map(|&a| self.item(frame, a)).collect();
                let value = self.call(&self.of.module.functions[*function], arguments);
                if let (Some(result), Some(value)) = (result, value) {
                    frame.items[result.index()] = Some(Item::Value(value));
                }
            }
            Statement::SubgroupGather { argument, result, .. }
            | Statement::SubgroupCollectiveOperation { argument, result, .. } => {
                let mut value = self.value(frame, *argument);
                let count = value.numbers.len() as f64;
                value.ready = self.issue(count, self.latencies.workgroup, value.ready);
                value.numbers.iter_mut().for_each(|number| *number = number.unknown());
                frame.items[result.index()] = Some(Item::Value(value));
            }
            _ => {}
        }
        Flow::Next
    }

    /// Goes through the case for this value, else through the default.
    fn case(&mut self, frame: &mut Frame<'a>, cases: &'a [SwitchCase], wanted: i64) -> Flow {
        let is = |value: SwitchValue| match value {
            SwitchValue::I32(v) => wanted == i64::from(v),
            SwitchValue::U32(v) => wanted == i64::from(v),
            SwitchValue::Default => false,
        };
        let default = || cases.iter().find(|case| case.value == SwitchValue::Default);
        let case = cases.iter().find(|case| is(case.value)).or_else(default);
        case.map_or(Flow::Next, |case| self.block(frame, &case.body))
    }

    fn branch(
        &mut self,
        frame: &mut Frame<'a>,
        condition: Handle<Expression>,
        sides: [&'a Block; 2],
    ) -> Flow {
        let condition = self.value(frame, condition);
        if let Number::Truth(Some(known)) = condition.numbers[0] {
            return self.block(frame, sides[usize::from(!known)]);
        }
        self.issue(1.0, 0.0, condition.ready);
        let flows = sides.map(|side| self.block(frame, side));
        self.doubtful |= flows.contains(&Flow::Break);
        // As long as some lanes go on.
        if flows[0] == flows[1] { flows[0] } else { Flow::Next }
    }

    fn turns(
        &mut self,
        frame: &mut Frame<'a>,
        [body, continuing]: [&'a Block; 2],
        end: Option<Handle<Expression>>,
    ) -> Flow {
        let outside = self.doubtful;
        let mut doubtful_turns = 0;
        let mut flow = Flow::Next;
        for _ in 0..MOST_TURNS {
            self.doubtful = false;
            match self.block(frame, body) {
                Flow::Break => break,
                Flow::Return => {
                    flow = Flow::Return;
                    break;
                }
                Flow::Next | Flow::Continue => {}
            }
            self.block(frame, continuing);
            if let Some(end) = end {
                match self.value(frame, end).numbers[0] {
                    Number::Truth(Some(false)) => {}
                    Number::Truth(Some(true)) => break,
                    _ => self.doubtful = true,
                }
            }
            doubtful_turns += usize::from(self.doubtful);
            if doubtful_turns >= DOUBTFUL_TURNS {
                break;
            }
        }
        self.doubtful = outside;
        flow
    }

    fn item(&mut self, frame: &mut Frame<'a>, expression: Handle<Expression>) -> Item {
        if let Some(item) = &frame.items[expression.index()] {
            return item.clone();
        }
        // Expressions that need no statement to be evaluated.
        self.compute(frame, expression)
    }

    fn value(&mut self, frame: &mut Frame<'a>, expression: Handle<Expression>) -> Value {
        match self.item(frame, expression) {
            Item::Value(value) => value,
            // A texture, whose handle is no number.
            Item::Place(place) => {
                Value { shape: place.shape, numbers: vec![], ready: place.ready, varies: place.varies }
            }
        }
    }

    fn place(&mut self, frame: &mut Frame<'a>, expression: Handle<Expression>) -> Place {
        match self.item(frame, expression) {
            Item::Place(place) => place,
            Item::Value(value) => unreachable!("a pointer, not {value:?}"),
        }
    }

    /// Returns the place of a part.
    fn part(&self, place: &Place, index: Option<usize>) -> Place {
        let (numbers, bytes, shape) = match place.shape {
            Shape::Scalar(_) => (Some(0), Some(0), place.shape),
            Shape::Vector(_, number) => (index, index.map(|i| 4 * i), Shape::Scalar(number)),
            Shape::Matrix(_, rows) => {
                let stride = if rows == 2 { 8 } else { 16 };
                (index.map(|i| i * rows), index.map(|i| i * stride), Shape::Vector(rows, Number::Float))
            }
            Shape::Of(ty) => match self.inner(ty) {
                TypeInner::Struct { members, .. } => {
                    let index = index.expect("members have fixed indices");
                    let before = members[..index].iter().map(|m| self.blank(self.shape(m.ty)).len()).sum();
                    (Some(before), Some(members[index].offset as usize), self.shape(members[index].ty))
                }
                &TypeInner::Array { base, stride, .. } => {
                    let shape = self.shape(base);
                    // Only of variables in registers are numbers known.
                    let each = match place.space {
                        Space::Local(_) | Space::Private(_) => self.blank(shape).len(),
                        _ => 0,
                    };
                    (index.map(|i| i * each), index.map(|i| i * stride as usize), shape)
                }
                other => unreachable!("a part of {other:?}"),
            },
        };
        let sum = |a: Option<usize>, b: Option<usize>| Some(a? + b?);
        Place { at: sum(place.at, numbers), bytes: sum(place.bytes, bytes), shape, ..place.clone() }
    }

    /// Returns a part of a value.
    fn element(&self, value: &Value, index: Option<usize>) -> Value {
        let of_value = Place {
            space: Space::Private(
                self.of.module.global_variables.iter().next().expect("a kernel has bindings").0,
            ),
            shape: value.shape,
            at: Some(0),
            bytes: Some(0),
            ready: value.ready,
            varies: value.varies,
        };
        let part = self.part(&of_value, index);
        let blank = self.blank(part.shape);
        let known = part.at.and_then(|at| value.numbers.get(at..at + blank.len()));
        let numbers = known.map_or(blank.clone(), <[Number]>::to_vec);
        Value { shape: part.shape, numbers, ready: value.ready, varies: value.varies }
    }

    fn compute(&mut self, frame: &mut Frame<'a>, expression: Handle<Expression>) -> Item {
        let value = match frame.function.expressions[expression] {
            Expression::GlobalVariable(variable) => return Item::Place(self.variable(variable)),
            Expression::LocalVariable(variable) => {
                let shape = self.shape(frame.function.local_variables[variable].ty);
                let (at, bytes) = (Some(0), Some(0));
                return Item::Place(Place {
                    space: Space::Local(variable),
                    shape,
                    at,
                    bytes,
                    ready: 0.0,
                    varies: false,
                });
            }
            Expression::FunctionArgument(index) => return frame.arguments[index as usize].clone(),
            Expression::AccessIndex { base, index } => {
                let index = Some(index as usize);
                match self.item(frame, base) {
                    Item::Place(place) => return Item::Place(self.part(&place, index)),
                    Item::Value(value) => self.element(&value, index),
                }
            }
            Expression::Access { base, index } => {
                let index = self.value(frame, index);
                let known = index.numbers[0].whole().and_then(|i| usize::try_from(i).ok());
                match self.item(frame, base) {
                    Item::Place(place) => {
                        let mut part = self.part(&place, known);
                        part.ready = part.ready.max(index.ready);
                        part.varies |= index.varies;
                        return Item::Place(part);
                    }
                    Item::Value(value) => {
                        let mut part = self.element(&value, known);
                        part.ready = part.ready.max(index.ready);
                        part.varies |= index.varies;
                        part
                    }
                }
            }
            Expression::Literal(literal) => Value::literal(literal),
            Expression::Constant(constant) => self.global(self.of.module.constants[constant].init),
            Expression::Override(constant) => self.given(constant),
            Expression::ZeroValue(ty) => self.zero(ty),
            Expression::Compose { ty, ref components } => {
                let parts: Vec<_> = components.iter().map(|&c| self.value(frame, c)).collect();
                Value::composed(self.shape(ty), parts.into_iter())
            }
            Expression::Splat { size, value } => Value::splat(size as usize, &self.value(frame, value)),
            Expression::Swizzle { size, vector, pattern } => {
                let value = self.value(frame, vector);
                let numbers: Vec<_> =
                    pattern[..size as usize].iter().map(|&c| value.numbers[c as usize]).collect();
                Value { shape: Shape::Vector(size as usize, numbers[0].unknown()), numbers, ..value }
            }
            Expression::Load { pointer } => {
                let place = self.place(frame, pointer);
                self.load(frame, &place)
            }
            Expression::ImageLoad { coordinate, .. } => {
                let at = self.value(frame, coordinate);
                let ready = self.issue(1.0, self.latencies.memory, at.ready);
                self.work.memory_bytes += if at.varies { 16.0 } else { 16.0 / f64::from(WARP) };
                let numbers = vec![Number::Float; 4];
                Value { shape: Shape::Vector(4, Number::Float), numbers, ready, varies: at.varies }
            }
            // A sign is part of the instruction that takes it.
            Expression::Unary { op, expr } => Value::unary(op, &self.value(frame, expr)),
            Expression::Binary { op, left, right } => {
                let (left, right) = (self.value(frame, left), self.value(frame, right));
                self.operator(op, &left, &right)
            }
            Expression::Select { condition, accept, reject } => {
                let condition = self.value(frame, condition);
                let [accept, reject] = [accept, reject].map(|side| self.value(frame, side));
                let of = |k: usize| match condition.numbers[k % condition.numbers.len()] {
                    Number::Truth(Some(true)) => accept.numbers[k],
                    Number::Truth(Some(false)) => reject.numbers[k],
                    _ => accept.numbers[k].unknown(),
                };
                let numbers = (0..accept.numbers.len()).map(of).collect();
                let ready = condition.ready.max(accept.ready).max(reject.ready);
                let varies = condition.varies || accept.varies || reject.varies;
                self.charge(Value { shape: accept.shape, numbers, ready, varies }, 1.0, 0.0)
            }
            Expression::Relational { argument, .. } => {
                let value = self.value(frame, argument);
                let all = value.numbers.iter().map(|n| n.whole()).collect::<Option<Vec<_>>>();
                let known = all.filter(|all| all.iter().all(|&v| v == all[0])).map(|all| all[0] != 0);
                let shape = Shape::Scalar(Number::Truth(None));
                self.charge(Value { shape, numbers: vec![Number::Truth(known)], ..value }, 1.0, 0.0)
            }
            Expression::Math { fun, arg, arg1, arg2, .. } => {
                let first = self.value(frame, arg);
                let others = [arg1, arg2].map(|other| other.map(|other| self.value(frame, other)));
                self.function(fun, first, others)
            }
            Expression::As { expr, kind, convert } => {
                let value = self.value(frame, expr);
                let of = |number: &Number| match (Number::of(kind), number.whole()) {
                    (to, Some(known)) if convert.is_some() || *number != Number::Float => to.with(known),
                    (to, _) => to,
                };
                let numbers: Vec<_> = value.numbers.iter().map(of).collect();
                let shape = match value.shape {
                    Shape::Scalar(_) => Shape::Scalar(Number::of(kind)),
                    Shape::Vector(size, _) => Shape::Vector(size, Number::of(kind)),
                    other => other,
                };
                let same = numbers == value.numbers || convert.is_none();
                let result = Value { shape, numbers, ..value };
                if same { result } else { self.charge(result, 1.0, 0.0) }
            }
            // Results of statements, which have been stored, and lengths.
            _ => Value { ready: self.clock, varies: true, ..Value::scalar(Number::Unsigned(None)) },
        };
        Item::Value(value)
    }

    fn variable(&mut self, variable: Handle<GlobalVariable>) -> Place {
        let of = &self.of.module.global_variables[variable];
        let shape = self.shape(of.ty);
        let space = match of.space {
            AddressSpace::Private => {
                if !self.private.contains_key(&variable) {
                    let numbers = self.blank(shape).into_iter().map(Number::zero).collect();
                    self.private.insert(variable, Variable { numbers, ready: 0.0, varies: false });
                }
                Space::Private(variable)
            }
            AddressSpace::WorkGroup => Space::Workgroup,
            AddressSpace::Uniform => Space::Uniform,
            _ => Space::Memory,
        };
        // The parameters are binding 0; other uniforms are data.
        let is_params = of.binding.is_some_and(|binding| binding.binding == 0);
        let bytes = (space != Space::Uniform || is_params).then_some(0);
        Place { space, shape, at: Some(0), bytes, ready: 0.0, varies: false }
    }

    /// Counts an access of `count` numbers.
    fn access(&mut self, place: &Place, count: usize, ready: f64) -> f64 {
        let bytes = 4.0 * count as f64 * if place.varies { 1.0 } else { 1.0 / f64::from(WARP) };
        let latency = match place.space {
            Space::Workgroup => {
                self.work.workgroup_bytes += bytes;
                self.latencies.workgroup
            }
            _ => {
                self.work.memory_bytes += bytes;
                self.latencies.memory
            }
        };
        self.issue(1.0, latency, ready)
    }

    fn load(&mut self, frame: &mut Frame<'a>, place: &Place) -> Value {
        let blank = self.blank(place.shape);
        let variable = match place.space {
            Space::Local(variable) => &frame.locals[&variable],
            Space::Private(variable) => &self.private[&variable],
            Space::Uniform => {
                let word = |k: usize| {
                    let at = place.bytes? + 4 * k;
                    Some(u32::from_ne_bytes(self.of.params.get(at..at + 4)?.try_into().ok()?))
                };
                let of = |(k, number): (usize, Number)| {
                    word(k).map_or(number, |v| number.with(i64::from(v as i32)))
                };
                let numbers = blank.into_iter().enumerate().map(of).collect();
                return Value { shape: place.shape, numbers, ready: place.ready, varies: place.varies };
            }
            Space::Workgroup | Space::Memory => {
                let ready = self.access(place, blank.len(), place.ready);
                return Value { shape: place.shape, numbers: blank, ready, varies: place.varies };
            }
        };
        let known = place.at.and_then(|at| variable.numbers.get(at..at + blank.len()));
        Value {
            shape: place.shape,
            numbers: known.map_or(blank.clone(), <[Number]>::to_vec),
            ready: variable.ready.max(place.ready),
            varies: variable.varies || place.varies,
        }
    }

    fn store(&mut self, frame: &mut Frame<'a>, place: &Place, value: Value) {
        let variable = match place.space {
            Space::Local(variable) => frame.locals.get_mut(&variable),
            Space::Private(variable) => self.private.get_mut(&variable),
            _ => {
                self.stored = self.stored.max(place.ready).max(value.ready);
                self.access(place, value.numbers.len(), 0.0);
                return;
            }
        };
        let variable = variable.expect("variables exist");
        match place.at.and_then(|at| variable.numbers.get_mut(at..at + value.numbers.len())) {
            Some(numbers) => numbers.copy_from_slice(&value.numbers),
            None => variable.numbers.iter_mut().for_each(|number| *number = number.unknown()),
        }
        let is_whole = variable.numbers.len() == value.numbers.len();
        variable.ready = if is_whole { value.ready } else { variable.ready.max(value.ready) };
        variable.varies = value.varies || (!is_whole && variable.varies);
    }

    fn operator(&mut self, op: BinaryOperator, left: &Value, right: &Value) -> Value {
        use BinaryOperator as Op;
        let result = Value::combined(op, left, right);
        let products = match (left.shape, right.shape) {
            (Shape::Matrix(columns, _), Shape::Vector(..) | Shape::Matrix(..)) => columns,
            (Shape::Vector(..), Shape::Matrix(_, rows)) => rows,
            _ => 0,
        };
        if products > 0 && op == Op::Multiply {
            return self.charge(result, products as f64, 2.0 * products as f64);
        }
        let float = left.is_float();
        // Of a product and a sum most are one instruction.
        let per_number = match op {
            Op::Add | Op::Subtract | Op::Multiply if float => 0.5,
            Op::Divide if float => 8.0,
            Op::Divide | Op::Modulo => 10.0,
            _ => 1.0,
        };
        let operations = matches!(op, Op::Add | Op::Subtract | Op::Multiply | Op::Divide) && float;
        self.charge(result, per_number, f64::from(u8::from(operations)))
    }

    fn function(&mut self, fun: MathFunction, first: Value, others: [Option<Value>; 2]) -> Value {
        use MathFunction as F;
        let ready = others.iter().flatten().fold(first.ready, |ready, other| ready.max(other.ready));
        let varies = first.varies || others.iter().flatten().any(|other| other.varies);
        let pick = |value: &Option<Value>, k: usize| {
            value.as_ref().and_then(|value| value.numbers[k % value.numbers.len()].whole())
        };
        let of = |k: usize| {
            let number = first.numbers[k];
            let known = match (fun, number.whole(), pick(&others[0], k), pick(&others[1], k)) {
                (F::Min, Some(a), Some(b), _) => Some(a.min(b)),
                (F::Max, Some(a), Some(b), _) => Some(a.max(b)),
                (F::Clamp, Some(a), Some(b), Some(c)) => Some(a.max(b).min(c)),
                (F::Abs, Some(a), ..) => Some(a.abs()),
                _ => None,
            };
            known.map_or(number.unknown(), |known| number.with(known))
        };
        let size = first.numbers.len();
        let to_scalar = matches!(fun, F::Dot | F::Length | F::Distance | F::Determinant);
        let (shape, numbers) = match fun {
            _ if to_scalar => (Shape::Scalar(first.numbers[0].unknown()), vec![first.numbers[0].unknown()]),
            F::Unpack2x16float => (Shape::Vector(2, Number::Float), vec![Number::Float; 2]),
            F::Pack2x16float => (Shape::Scalar(Number::Unsigned(None)), vec![Number::Unsigned(None)]),
            F::Transpose => match first.shape {
                Shape::Matrix(columns, rows) => (Shape::Matrix(rows, columns), first.numbers.clone()),
                other => (other, first.numbers.clone()),
            },
            _ => (first.shape, (0..size).map(of).collect()),
        };
        let per_number = match fun {
            F::Dot => size as f64,
            F::Length | F::Distance => size as f64 + 4.0,
            F::Normalize => 3.0,
            F::Cross => 2.0,
            F::Transpose => return Value { shape, numbers, ready, varies },
            F::Sqrt | F::InverseSqrt | F::Exp | F::Exp2 | F::Log | F::Log2 | F::Sin | F::Cos => 4.0,
            F::Pow | F::Tanh | F::Atan2 | F::Acos | F::Asin | F::Atan => 16.0,
            _ => 1.0,
        };
        let operations = if fun == F::Dot { 2.0 * size as f64 } else { 1.0 };
        self.charge(Value { shape, numbers, ready, varies }, per_number, operations)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LATENCIES: Latencies = Latencies { memory: 300.0, workgroup: 30.0, arithmetic: 4.0 };

    /// Walks through a kernel of four workgroups with the parameter `count`.
    fn walked(text: &str, count: u32, constants: &[(&'static str, f64)]) -> Work {
        let head = "struct Params { count: u32 }
            @group(0) @binding(0) var<uniform> params: Params;
            @group(0) @binding(1) var<storage, read> x: array<vec4f>;
            @group(0) @binding(2) var<storage, read_write> y: array<vec4f>;
            override WIDE: u32 = 64;
            var<workgroup> memory: array<vec4f, 64>;";
        let module = naga::front::wgsl::parse_str(&format!("{head}\n{text}")).unwrap();
        let params = count.to_ne_bytes();
        work(&Walked { module: &module, constants, params: &params, groups: [4, 1, 1] }, LATENCIES)
    }

    #[test]
    fn loops_turn_as_often_as_the_parameters_say() {
        let text = "@compute @workgroup_size(WIDE)
            fn sums(@builtin(global_invocation_id) id: vec3u) {
                var sum = vec4f();
                for (var k = 0u; k < params.count; k += 2u) { sum += 3.0 * x[id.x * params.count + k]; }
                y[id.x] = sum;
            }";
        let [ten, twenty] = [20, 40].map(|count| walked(text, count, &[("WIDE", 32.0)]));
        assert_eq!((ten.groups, ten.invocations, ten.workgroup_memory), (4, 32, 1024));
        // A product and a sum of four numbers a turn, one load of 16 bytes, and the store.
        assert_eq!([ten.operations, twenty.operations], [80.0, 160.0]);
        assert_eq!([ten.memory_bytes, twenty.memory_bytes], [176.0, 336.0]);
        // Each turn waits for its load.
        let turn = (twenty.cycles - ten.cycles) / 10.0;
        assert!((300.0..330.0).contains(&turn), "{turn}");
        assert_eq!(walked(text, 20, &[]).invocations, 64);
    }

    #[test]
    fn loads_that_follow_each_other_are_under_way_together() {
        let of = |body: &str| {
            walked(
                &format!(
                    "@compute @workgroup_size(64) fn one(@builtin(local_invocation_index) i: u32) {{ {body} }}"
                ),
                7,
                &[],
            )
        };
        let together = of("let a = x[i]; let b = x[i + 64u]; let c = x[i + 128u]; y[i] = a + b + c;");
        assert!((300.0..350.0).contains(&together.cycles), "{together:?}");
        let chain = of("let a = x[i]; let b = x[u32(a.x)]; let c = x[u32(b.x)]; y[i] = c;");
        assert!((900.0..950.0).contains(&chain.cycles), "{chain:?}");
        // What all lanes read alike counts once for 32 of them.
        let alike = of("y[i] = x[params.count];");
        assert_eq!((alike.memory_bytes, chain.memory_bytes), (16.0 + 0.5, 64.0));
        // Stores of two turns wait together, for the barrier.
        let staged = "for (var k = i; k < 128u; k += 64u) { memory[k % 64u] = x[k]; } workgroupBarrier(); y[i] = memory[63u - i];";
        let staged = of(staged);
        assert!((330.0..430.0).contains(&staged.cycles), "{staged:?}");
        assert_eq!((staged.workgroup_bytes, staged.memory_bytes), (48.0, 48.0));
    }

    #[test]
    fn what_data_decides_is_counted_on_both_sides() {
        let text = "fn double(v: vec4f) -> vec4f { return v * 2.0; }
            @compute @workgroup_size(64) fn one(@builtin(local_invocation_index) i: u32) {
                var v = x[i];
                if v.x > 0.0 { v = double(v); } else { v = sqrt(v); }
                if params.count > 5u { v += 1.0; }
                for (var k = 0u; k < 9u; k++) { if x[k].x < 0.0 { break; } v += 1.0; }
                if i > params.count { return; }
                y[i] = v;
            }";
        let [small, large] = [3, 7].map(|count| walked(text, count, &[]));
        assert_eq!(large.operations - small.operations, 4.0);
        // The comparison is none; four products and roots, and a sum in each of two turns.
        assert_eq!(small.operations, 4.0 + 4.0 + 4.0 * DOUBTFUL_TURNS as f64);
        assert_eq!(small.memory_bytes, 16.0 + 16.0 + 4.0 / 32.0 * DOUBTFUL_TURNS as f64);
    }
}

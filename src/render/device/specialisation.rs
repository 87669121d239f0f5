//! Specialisation of programs: what the values of overrides rule out leaves a program before a driver sees it.
//!
//! A driver removes what is never reached too, but only after it has translated all of it, and in its own time: on Mesa's CPU driver that
//! was a third of the time until the first frame. Removed are branches whose condition is known from overrides, from constants, and from
//! arguments that are the same constant in all calls; then whatever nothing uses any more.
//! Must not know: a program, a pass.

use std::collections::HashMap;
use std::mem;

use wgpu::naga::{
    Arena, BinaryOperator, Block, Constant, Expression, Function, Handle, Literal, LocalVariable, Module,
    Override, Scalar, Span, Statement, TypeInner, UnaryOperator,
    compact::{KeepUnused, compact},
};

/// A copy of a valid module with these entry points alone, where overrides have these values. An override without a value stays one.
#[must_use]
pub(crate) fn specialised(module: &Module, entry_points: &[&str], constants: &[(&str, f64)]) -> Module {
    let mut module = module.clone();
    module.entry_points.retain(|entry_point| entry_points.contains(&entry_point.name.as_str()));
    let globals = Globals::new(&module, constants);
    let mut calls = Calls::new();
    for entry_point in &mut module.entry_points {
        specialise(&mut entry_point.function, &[], &globals, &mut calls);
    }
    // Backwards each function comes after all that call it.
    let functions: Vec<_> = module.functions.iter().map(|(handle, _)| handle).collect();
    for handle in functions.into_iter().rev() {
        if let Some(arguments) = calls.remove(&handle) {
            specialise(&mut module.functions[handle], &arguments, &globals, &mut calls);
        }
    }
    compact(&mut module, KeepUnused::No);
    module
}

/// Of each called function the arguments that are the same in all calls so far.
type Calls = HashMap<Handle<Function>, Vec<Option<Literal>>>;

/// What is known of a module.
struct Globals {
    constants: HashMap<Handle<Constant>, Literal>,
    overrides: HashMap<Handle<Override>, Literal>,
}

impl Globals {
    fn new(module: &Module, values: &[(&str, f64)]) -> Self {
        let constants = module.constants.iter().filter_map(|(handle, constant)| {
            match module.global_expressions[constant.init] {
                Expression::Literal(literal) => Some((handle, literal)),
                _ => None,
            }
        });
        let overrides = module.overrides.iter().filter_map(|(handle, declared)| {
            let (_, value) = values.iter().find(|(name, _)| declared.name.as_deref() == Some(name))?;
            match module.types[declared.ty].inner {
                TypeInner::Scalar(scalar) => Some((handle, literal(*value, scalar)?)),
                _ => None,
            }
        });
        Self { constants: constants.collect(), overrides: overrides.collect() }
    }
}

/// The value of an override as a literal of its type.
fn literal(value: f64, scalar: Scalar) -> Option<Literal> {
    match scalar {
        Scalar::BOOL => Some(Literal::Bool(value != 0.0)),
        Scalar::U32 => Some(Literal::U32(value as u32)),
        Scalar::I32 => Some(Literal::I32(value as i32)),
        Scalar::F32 => Some(Literal::F32(value as f32)),
        _ => None,
    }
}

/// Whether a literal decides branches. Zeroes of floats are equal and not the same, so none of them does.
const fn is_discrete(literal: Literal) -> bool {
    matches!(literal, Literal::Bool(_) | Literal::U32(_) | Literal::I32(_))
}

/// Removes the branches of a function that cannot be taken with these arguments, and adds the calls of the others.
fn specialise(function: &mut Function, arguments: &[Option<Literal>], globals: &Globals, calls: &mut Calls) {
    for (_, expression) in function.expressions.iter_mut() {
        let known = match *expression {
            Expression::Override(handle) => globals.overrides.get(&handle).copied(),
            Expression::FunctionArgument(index) => arguments.get(index as usize).copied().flatten(),
            _ => None,
        };
        if let Some(literal) = known {
            *expression = Expression::Literal(literal);
        }
    }
    // They would stay although no statement needs them.
    function.named_expressions.clear();
    let body = mem::take(&mut function.body);
    let mut pruning = Pruning {
        expressions: &function.expressions,
        variables: &function.local_variables,
        globals,
        stored: HashMap::new(),
        calls,
    };
    function.body = pruning.block(body);
}

/// The removal of branches of a function, statement by statement.
struct Pruning<'a> {
    expressions: &'a Arena<Expression>,
    variables: &'a Arena<LocalVariable>,
    globals: &'a Globals,
    /// What all stores so far write to the results of `&&` and `||`, which WGSL's front end makes branches of; `None` where they differ.
    stored: HashMap<Handle<LocalVariable>, Option<Literal>>,
    calls: &'a mut Calls,
}

impl Pruning<'_> {
    fn block(&mut self, block: Block) -> Block {
        let mut pruned = Block::with_capacity(block.len());
        for (statement, span) in block.span_into_iter() {
            self.statement(statement, span, &mut pruned);
            if pruned.last().is_some_and(ends_block) {
                break;
            }
        }
        pruned
    }

    /// Adds what stays of a statement.
    fn statement(&mut self, statement: Statement, span: Span, pruned: &mut Block) {
        let statement = match statement {
            Statement::If { condition, accept, reject } => match self.value(condition) {
                Some(Literal::Bool(is_taken)) => {
                    pruned.extend_block(self.block(if is_taken { accept } else { reject }));
                    return;
                }
                _ => {
                    let (accept, reject) = (self.block(accept), self.block(reject));
                    if accept.is_empty() && reject.is_empty() {
                        return;
                    }
                    Statement::If { condition, accept, reject }
                }
            },
            Statement::Block(block) => Statement::Block(self.block(block)),
            Statement::Loop { body, continuing, break_if } => {
                Statement::Loop { body: self.block(body), continuing: self.block(continuing), break_if }
            }
            Statement::Switch { selector, mut cases } => {
                for case in &mut cases {
                    case.body = self.block(mem::take(&mut case.body));
                }
                Statement::Switch { selector, cases }
            }
            Statement::Store { pointer, value } => {
                self.store(pointer, value);
                Statement::Store { pointer, value }
            }
            Statement::Call { function, arguments, result } => {
                self.call(function, &arguments);
                Statement::Call { function, arguments, result }
            }
            other => other,
        };
        pruned.push(statement, span);
    }

    fn store(&mut self, pointer: Handle<Expression>, value: Handle<Expression>) {
        let Expression::LocalVariable(handle) = self.expressions[pointer] else { return };
        let variable = &self.variables[handle];
        // Those of the front end have no name. They are written before they are read, in the same pass through a loop.
        if variable.name.is_none() && variable.init.is_none() {
            let value = self.value(value);
            let stored = self.stored.entry(handle).or_insert(value);
            *stored = stored.filter(|stored| value == Some(*stored));
        }
    }

    fn call(&mut self, function: Handle<Function>, arguments: &[Handle<Expression>]) {
        let values: Vec<_> =
            arguments.iter().map(|argument| self.value(*argument).filter(|v| is_discrete(*v))).collect();
        match self.calls.get_mut(&function) {
            None => drop(self.calls.insert(function, values)),
            Some(known) => {
                for (known, value) in known.iter_mut().zip(values) {
                    *known = known.filter(|known| value == Some(*known));
                }
            }
        }
    }

    /// The value of an expression that decides branches, where it is known.
    fn value(&self, expression: Handle<Expression>) -> Option<Literal> {
        match self.expressions[expression] {
            Expression::Literal(literal) => Some(literal),
            Expression::Constant(handle) => self.globals.constants.get(&handle).copied(),
            Expression::Load { pointer } => match self.expressions[pointer] {
                Expression::LocalVariable(handle) => self.stored.get(&handle).copied().flatten(),
                _ => None,
            },
            Expression::Unary { op: UnaryOperator::LogicalNot, expr } => match self.value(expr)? {
                Literal::Bool(value) => Some(Literal::Bool(!value)),
                _ => None,
            },
            Expression::Binary { op, left, right } => self.binary(op, left, right),
            _ => None,
        }
    }

    fn binary(
        &self,
        op: BinaryOperator,
        left: Handle<Expression>,
        right: Handle<Expression>,
    ) -> Option<Literal> {
        use BinaryOperator::{
            And, Equal, Greater, GreaterEqual, InclusiveOr, Less, LessEqual, LogicalAnd, LogicalOr, NotEqual,
        };
        match op {
            And | LogicalAnd | InclusiveOr | LogicalOr => {
                let (left, right) = (self.value(left), self.value(right));
                let is_and = matches!(op, And | LogicalAnd);
                // One that is false decides `and`, one that is true `or`; else both count.
                let deciding = Literal::Bool(!is_and);
                match (left, right) {
                    (Some(Literal::U32(left)), Some(Literal::U32(right))) => {
                        Some(Literal::U32(if is_and { left & right } else { left | right }))
                    }
                    _ if left == Some(deciding) || right == Some(deciding) => Some(deciding),
                    (Some(Literal::Bool(_)), Some(Literal::Bool(_))) => Some(Literal::Bool(is_and)),
                    _ => None,
                }
            }
            Equal | NotEqual | Less | LessEqual | Greater | GreaterEqual => {
                let order = match (self.value(left)?, self.value(right)?) {
                    (Literal::Bool(left), Literal::Bool(right)) => left.cmp(&right),
                    (Literal::U32(left), Literal::U32(right)) => left.cmp(&right),
                    (Literal::I32(left), Literal::I32(right)) => left.cmp(&right),
                    _ => return None,
                };
                Some(Literal::Bool(match op {
                    Equal => order.is_eq(),
                    NotEqual => order.is_ne(),
                    Less => order.is_lt(),
                    LessEqual => order.is_le(),
                    Greater => order.is_gt(),
                    _ => order.is_ge(),
                }))
            }
            _ => None,
        }
    }
}

/// Whether nothing after a statement is reached.
fn ends_block(statement: &Statement) -> bool {
    match statement {
        Statement::Return { .. } | Statement::Break | Statement::Continue | Statement::Kill => true,
        Statement::Block(block) => block.last().is_some_and(ends_block),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::device::shader_programs::{PROGRAMS, parse};
    use wgpu::naga::{
        front::wgsl::parse_str,
        valid::{Capabilities, ValidationFlags, Validator},
    };

    const TEXT: &str = "
override HAS_DETAIL: bool;
override MODE: u32;
const FINE: u32 = 2u;
@group(0) @binding(0) var<storage, read> heights: array<f32>;
@group(0) @binding(1) var<storage, read_write> out: array<f32>;
fn coarse() -> f32 { return 1.0; }
fn detail(i: u32) -> f32 { return heights[i]; }
fn height(i: u32, mode: u32, is_doubled: bool) -> f32 {
    if mode == FINE { return detail(i); }
    if is_doubled { return 2.0 * coarse(); }
    return coarse();
}
@compute @workgroup_size(1)
fn cs_main(@builtin(global_invocation_id) id: vec3<u32>) {
    if HAS_DETAIL && id.y > 0u {
        out[1] = detail(id.x);
    }
    out[0] = height(id.x, MODE, id.y > 1u) + height(id.y, MODE, false);
}
@compute @workgroup_size(1)
fn cs_other() { out[2] = 1.0; }
";

    fn assert_valid(module: &Module, name: &str) {
        let result = Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(module);
        result.unwrap_or_else(|error| panic!("{name}: {error:?}"));
    }

    fn functions(constants: &[(&str, f64)]) -> (Vec<String>, usize) {
        let module = parse_str(TEXT).expect("a valid program");
        let module = specialised(&module, &["cs_main"], constants);
        assert_valid(&module, "the program");
        assert_eq!(module.entry_points.len(), 1);
        let names = module.functions.iter().map(|(_, function)| function.name.clone().unwrap_or_default());
        (names.collect(), module.global_variables.len())
    }

    #[test]
    fn what_no_branch_reaches_leaves_the_program() {
        let (all, variables) = functions(&[("HAS_DETAIL", 1.0), ("MODE", 0.0)]);
        assert_eq!((all, variables), (vec!["coarse".into(), "detail".into(), "height".into()], 2));
        // Of the buffer of heights nothing is left either.
        let (all, variables) = functions(&[("HAS_DETAIL", 0.0), ("MODE", 0.0)]);
        assert_eq!((all, variables), (vec!["coarse".into(), "height".into()], 1));
        // What follows a return is not reached.
        let (all, variables) = functions(&[("HAS_DETAIL", 0.0), ("MODE", 2.0)]);
        assert_eq!((all, variables), (vec!["detail".into(), "height".into()], 2));
    }

    #[test]
    fn an_argument_that_differs_between_calls_decides_nothing() {
        let text = TEXT.replace("height(id.y, MODE, false)", "height(id.y, 2u, false)");
        let module = parse_str(&text).expect("a valid program");
        let module = specialised(&module, &["cs_main"], &[("HAS_DETAIL", 0.0), ("MODE", 0.0)]);
        assert_eq!(module.functions.len(), 3);
    }

    #[test]
    fn an_override_without_a_value_stays() {
        let module = parse_str(TEXT).expect("a valid program");
        let kept = |constants: &[(&str, f64)]| specialised(&module, &["cs_main"], constants).overrides.len();
        assert_eq!(
            [kept(&[]), kept(&[("MODE", 1.0)]), kept(&[("MODE", 1.0), ("HAS_DETAIL", 0.0)])],
            [2, 1, 0]
        );
    }

    /// For many values of overrides: a driver gets no module that is not valid.
    #[test]
    fn every_program_stays_valid() {
        for program in PROGRAMS {
            let module = parse(program);
            let names: Vec<_> =
                module.overrides.iter().filter_map(|(_, declared)| declared.name.clone()).collect();
            for entry_point in &module.entry_points {
                for values in 0_u32..64 {
                    let value = |(index, name): (u32, &str)| {
                        // Resolve divides by it.
                        let least = u32::from(name == "SAMPLES_PER_SIDE");
                        f64::from((values >> (index % 6) & 3).max(least))
                    };
                    let names = (0..).zip(names.iter().map(String::as_str));
                    let constants: Vec<_> = names.map(|numbered| (numbered.1, value(numbered))).collect();
                    let module = specialised(&module, &[&entry_point.name], &constants);
                    assert_valid(&module, program.name);
                    assert!(module.overrides.is_empty(), "{}", program.name);
                }
            }
        }
    }
}

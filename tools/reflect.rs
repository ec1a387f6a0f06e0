// Reads the parts of a SPIR-V module on which the host must agree: bindings, push constants, specialization constants.
// Part of build.rs.

use rspirv::dr::{Instruction, Module, Operand};
use rspirv::spirv::{Decoration, Op, StorageClass, Word};
use std::collections::{BTreeMap, HashMap};

/// A type with a fixed layout, as both sides see it.
#[derive(Clone, Debug, PartialEq)]
pub enum Type {
    F32,
    U32,
    I32,
    Vector(Box<Type>, u32),
    Array(Box<Type>, u32),
    Struct(String),
}

/// A struct as laid out in a buffer or in push constants: name, (field, offset, type), size in bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct Struct {
    pub name: String,
    pub fields: Vec<(String, u32, Type)>,
    pub size: u32,
}

#[derive(Debug)]
pub struct Binding {
    pub index: u32,
    pub name: String,
    pub element: Type,
    pub reads: bool,
    pub writes: bool,
}

#[derive(Debug)]
pub struct Constant {
    pub id: u32,
    pub name: String,
    pub kind: &'static str,
    pub default: u32,
}

#[derive(Debug, Default)]
pub struct Reflection {
    pub bindings: Vec<Binding>,
    pub push: Option<Struct>,
    pub constants: Vec<Constant>,
    pub structs: BTreeMap<String, Struct>,
}

struct Reader {
    names: HashMap<Word, String>,
    member_names: HashMap<(Word, u32), String>,
    decorations: HashMap<(Word, Decoration), u32>,
    member_decorations: HashMap<(Word, u32, Decoration), u32>,
    values: HashMap<Word, Instruction>,
    structs: BTreeMap<String, Struct>,
}

fn id(operand: &Operand) -> Word {
    operand.id_ref_any().expect("an id")
}

fn literal(operand: Option<&Operand>) -> u32 {
    match operand {
        Some(Operand::LiteralBit32(v)) => *v,
        _ => 0,
    }
}

fn decoration(operand: &Operand) -> Decoration {
    match operand {
        Operand::Decoration(d) => *d,
        other => panic!("{other:?} is no decoration"),
    }
}

impl Reader {
    fn new(module: &Module) -> Self {
        let mut reader = Self {
            names: HashMap::new(),
            member_names: HashMap::new(),
            decorations: HashMap::new(),
            member_decorations: HashMap::new(),
            values: HashMap::new(),
            structs: BTreeMap::new(),
        };
        for i in &module.debug_names {
            match (i.class.opcode, i.operands.as_slice()) {
                (Op::Name, [target, Operand::LiteralString(name)]) => {
                    reader.names.insert(id(target), name.clone());
                }
                (Op::MemberName, [target, Operand::LiteralBit32(member), Operand::LiteralString(name)]) => {
                    reader.member_names.insert((id(target), *member), name.clone());
                }
                _ => {}
            }
        }
        for i in &module.annotations {
            let o = &i.operands;
            match i.class.opcode {
                Op::Decorate => {
                    reader.decorations.insert((id(&o[0]), decoration(&o[1])), literal(o.get(2)));
                }
                Op::MemberDecorate => {
                    let key = (id(&o[0]), literal(Some(&o[1])), decoration(&o[2]));
                    reader.member_decorations.insert(key, literal(o.get(3)));
                }
                _ => {}
            }
        }
        for i in &module.types_global_values {
            if let Some(result) = i.result_id {
                reader.values.insert(result, i.clone());
            }
        }
        reader
    }

    fn layout(&mut self, type_id: Word) -> Type {
        let i = self.values[&type_id].clone();
        match i.class.opcode {
            Op::TypeFloat => Type::F32,
            Op::TypeInt if literal(i.operands.get(1)) == 0 => Type::U32,
            Op::TypeInt => Type::I32,
            Op::TypeVector => Type::Vector(Box::new(self.layout(id(&i.operands[0]))), literal(i.operands.get(1))),
            Op::TypeArray => {
                let length = literal(self.values[&id(&i.operands[1])].operands.first());
                Type::Array(Box::new(self.layout(id(&i.operands[0]))), length)
            }
            Op::TypeStruct => {
                let s = self.structure(type_id);
                let name = s.name.clone();
                self.structs.insert(name.clone(), s);
                Type::Struct(name)
            }
            other => panic!("{other:?} has no layout that the host knows"),
        }
    }

    fn structure(&mut self, type_id: Word) -> Struct {
        let members = self.values[&type_id].operands.clone();
        let fields: Vec<_> = (0..members.len() as u32)
            .map(|m| {
                let name = self.member_names[&(type_id, m)].clone();
                let offset = self.member_decorations[&(type_id, m, Decoration::Offset)];
                (name, offset, self.layout(id(&members[m as usize])))
            })
            .collect();
        let end = fields.iter().map(|(_, offset, t)| offset + self.size(t)).max().unwrap_or(0);
        Struct { name: self.names[&type_id].clone(), fields, size: end.next_multiple_of(4) }
    }

    fn size(&self, t: &Type) -> u32 {
        match t {
            Type::F32 | Type::U32 | Type::I32 => 4,
            Type::Vector(e, n) | Type::Array(e, n) => self.size(e) * n,
            Type::Struct(name) => self.structs[name].size,
        }
    }

    fn binding(&mut self, variable: Word, struct_id: Word) -> Binding {
        // A buffer block holds one member: a runtime array of elements, or one struct.
        let member = id(&self.values[&struct_id].operands[0]);
        let inner = self.values[&member].clone();
        let element = if inner.class.opcode == Op::TypeRuntimeArray { id(&inner.operands[0]) } else { member };
        let has = |d| {
            self.decorations.contains_key(&(variable, d)) || self.member_decorations.contains_key(&(struct_id, 0, d))
        };
        Binding {
            index: self.decorations[&(variable, Decoration::Binding)],
            name: self.member_names[&(struct_id, 0)].clone(),
            reads: !has(Decoration::NonReadable),
            writes: !has(Decoration::NonWritable),
            element: self.layout(element),
        }
    }
}

/// Reflects one compute module.
pub fn reflect(words: &[u32]) -> Reflection {
    let module = rspirv::dr::load_words(words).expect("a module is well-formed SPIR-V");
    let mut reader = Reader::new(&module);
    let mut out = Reflection::default();
    for i in &module.types_global_values {
        match i.class.opcode {
            Op::Variable => {
                let variable = i.result_id.expect("a variable has an id");
                let pointer = reader.values[&i.result_type.expect("a variable has a type")].clone();
                let pointee = id(&pointer.operands[1]);
                match i.operands[0] {
                    Operand::StorageClass(StorageClass::StorageBuffer) => {
                        let binding = reader.binding(variable, pointee);
                        out.bindings.push(binding);
                    }
                    Operand::StorageClass(StorageClass::PushConstant) => out.push = Some(reader.structure(pointee)),
                    _ => {}
                }
            }
            Op::SpecConstant | Op::SpecConstantTrue | Op::SpecConstantFalse => {
                let constant = i.result_id.expect("a constant has an id");
                let (Some(spec), Some(name)) =
                    (reader.decorations.get(&(constant, Decoration::SpecId)), reader.names.get(&constant))
                else {
                    continue;
                };
                let kind = match reader.values[&i.result_type.expect("a constant has a type")].class.opcode {
                    Op::TypeBool => "bool",
                    Op::TypeFloat => "f32",
                    _ => "u32",
                };
                let default = match i.class.opcode {
                    Op::SpecConstant => literal(i.operands.first()),
                    Op::SpecConstantTrue => 1,
                    _ => 0,
                };
                if out.constants.iter().all(|c| c.id != *spec) {
                    out.constants.push(Constant { id: *spec, name: name.clone(), kind, default });
                }
            }
            _ => {}
        }
    }
    out.bindings.sort_by_key(|b| b.index);
    out.constants.sort_by_key(|c| c.id);
    out.structs = reader.structs;
    out
}

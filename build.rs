//! Compiles and validates every shader with naga and writes the host side of each compute kernel
//! from naga's own reflection, so that host and shader cannot drift. A bad shader fails the build
//! with file and line.
//!
//! `shaders/<kernel>.wgsl` gives a module `<kernel>` in `kernels.rs`: SPIR-V, workgroup size, a
//! `Params` struct laid out as the shader's `var<immediate>`, and a `Bindings` struct of typed
//! buffers in binding order. `shaders/draw/<pass>.wgsl` gives a `DrawShader` and `Params`.
//! A line `#include "lib/NAME.wgsl"` is replaced by that file, once a shader.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs};

use naga::proc::{BoundsCheckPolicies, BoundsCheckPolicy};
use naga::{AddressSpace, Module, ScalarKind, StorageAccess, TypeInner, VectorSize};

fn main() {
    println!("cargo::rustc-env=INTIMA_COMMIT={}", commit().unwrap_or_default());
    println!("cargo::rerun-if-changed=shaders");
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let shaders = Path::new("shaders");
    let mut host = String::new();
    let mut most = Most::default();
    for path in wgsl_files(shaders) {
        let built = Built::new(&path);
        built.write_spirv(&out, "");
        host += &built.kernel_module(&mut most);
    }
    let Most { workgroup, storage_buffers, params_bytes, shared_bytes } = most;
    let _ = write!(
        host,
        "/// Largest demands of any kernel.
pub static NEEDS: crate::compute::ShaderNeeds = crate::compute::ShaderNeeds {{
    workgroup: {workgroup},
    storage_buffers: {storage_buffers},
    params_bytes: {params_bytes},
    shared_bytes: {shared_bytes},
}};"
    );
    fs::write(out.join("kernels.rs"), host).expect("write kernels.rs");
    let mut host = String::new();
    for path in wgsl_files(&shaders.join("draw")) {
        let built = Built::new(&path);
        built.write_spirv(&out, "draw_");
        host += &built.draw_module();
    }
    fs::write(out.join("draw.rs"), host).expect("write draw.rs");
}

/// Commit of a release: named by `cargo xtask dist`, or kept by cargo in the package. Git is not
/// asked: each commit would then build everything anew.
fn commit() -> Option<String> {
    println!("cargo::rerun-if-env-changed=INTIMA_COMMIT");
    if let Ok(named) = env::var("INTIMA_COMMIT") {
        return Some(named);
    }
    let packaged = fs::read_to_string(".cargo_vcs_info.json").ok()?;
    let (_, rest) = packaged.split_once("\"sha1\": \"")?;
    rest.split_once('"').map(|(sha, _)| sha.to_owned())
}

fn wgsl_files(dir: &Path) -> Vec<PathBuf> {
    let mut files: Vec<_> = fs::read_dir(dir)
        .map(|d| d.filter_map(|e| e.ok().map(|e| e.path())).collect())
        .unwrap_or_default();
    files.retain(|p| p.extension().is_some_and(|e| e == "wgsl"));
    files.sort();
    files
}

/// Largest demands of the kernels so far.
#[derive(Default)]
struct Most {
    workgroup: u32,
    storage_buffers: u32,
    params_bytes: u32,
    shared_bytes: u32,
}

struct Built {
    stem: String,
    module: Module,
    info: naga::valid::ModuleInfo,
    spirv: Vec<u32>,
    /// The same with every index held within its array, for drivers that do not do so themselves.
    restricted: Vec<u32>,
}

impl Built {
    fn new(path: &Path) -> Self {
        let source = with_includes(path, &mut BTreeSet::new());
        let name = path.display().to_string();
        let options = naga::front::wgsl::Options {
            capabilities: naga::valid::Capabilities::all(),
            ..naga::front::wgsl::Options::new()
        };
        let module = naga::front::wgsl::Frontend::new_with_options(options)
            .parse(&source)
            .unwrap_or_else(|e| panic!("\n{}", e.emit_to_string_with_path(&source, &name)));
        let info = naga::valid::Validator::new(
            naga::valid::ValidationFlags::all(),
            naga::valid::Capabilities::all(),
        )
        .validate(&module)
        .unwrap_or_else(|e| panic!("\n{}", e.emit_to_string_with_path(&source, &name)));
        let compile = |bounds| {
            let words = naga::back::spv::write_vec(&module, &info, &spirv_options(bounds), None);
            joined_chains(&words.unwrap_or_else(|e| panic!("{name}: {e}")))
        };
        // Hot kernels pay 13-30 % for checks; the parity cases run under GPU-side validation.
        let spirv = compile(BoundsCheckPolicy::Unchecked);
        let restricted = compile(BoundsCheckPolicy::Restrict);
        let stem = path.file_stem().and_then(|s| s.to_str()).expect("UTF-8 name").to_owned();
        Self { stem, module, info, spirv, restricted }
    }

    fn write_spirv(&self, out: &Path, prefix: &str) {
        for (words, suffix) in [(&self.spirv, ""), (&self.restricted, "_restricted")] {
            let bytes: Vec<u8> = words.iter().flat_map(|w| w.to_ne_bytes()).collect();
            let name = format!("{prefix}{}{suffix}.spv", self.stem);
            fs::write(out.join(name), bytes).expect("write SPIR-V");
        }
    }

    fn draw_module(&self) -> String {
        let stem = &self.stem;
        let (params, push_bytes) = self
            .module
            .global_variables
            .iter()
            .find(|(_, v)| v.space == AddressSpace::Immediate)
            .map_or((String::new(), 0), |(_, v)| self.params(v.ty));
        let mut entries = String::new();
        for (number, e) in self.module.entry_points.iter().enumerate() {
            let used = self.info.get_entry_point(number);
            let is_read =
                |(handle, var): (naga::Handle<naga::GlobalVariable>, &naga::GlobalVariable)| {
                    var.binding.is_some() && !used[handle].is_empty()
                };
            let has_bindings = self.module.global_variables.iter().any(is_read);
            let is_vertex = e.stage == naga::ShaderStage::Vertex;
            let attributes = if is_vertex { self.locations(&e.function) } else { 0 };
            let _ = write!(
                entries,
                "DrawEntry {{ name: \"{}\", is_vertex: {is_vertex}, attributes: {attributes}, \
                 has_bindings: {has_bindings} }}, ",
                e.name
            );
        }
        let (images, buffers) = self.images_and_buffers();
        // Every device has that many.
        assert!(images <= 16, "{stem}: a stage reads 16 images, this one {images}");
        format!(
            "pub mod {stem} {{
    use crate::vk::{{DrawEntry, DrawShader}};
    pub static SHADER: DrawShader = DrawShader {{
        spirv: include_bytes!(concat!(env!(\"OUT_DIR\"), \"/draw_{stem}.spv\")),
        entries: &[{entries}],
        push_bytes: {push_bytes},
        images: {images},
        buffers: {buffers},
    }};
    {params}
}}\n"
        )
    }

    /// Locations that an entry point's arguments take.
    fn locations(&self, function: &naga::Function) -> u32 {
        let located = |b: &Option<naga::Binding>| matches!(b, Some(naga::Binding::Location { .. }));
        let of = |a: &naga::FunctionArgument| match &self.module.types[a.ty].inner {
            TypeInner::Struct { members, .. } => {
                members.iter().filter(|m| located(&m.binding)).count() as u32
            }
            _ => u32::from(located(&a.binding)),
        };
        function.arguments.iter().map(of).sum()
    }

    /// Images and buffers that a module for drawing reads: bindings 0, 1, … of group 0, images first,
    /// and nothing else is bound.
    fn images_and_buffers(&self) -> (u32, u32) {
        let (mut slots, mut buffers) = (Vec::new(), Vec::new());
        for (_, var) in self.module.global_variables.iter() {
            match var.space {
                AddressSpace::Immediate | AddressSpace::Private => {}
                AddressSpace::Handle => {
                    let image = &self.module.types[var.ty].inner;
                    assert!(matches!(image, TypeInner::Image { .. }), "{}: an image", self.stem);
                    let slot = var.binding.as_ref().expect("an image has a binding");
                    assert_eq!(slot.group, 0, "{}: one bind group", self.stem);
                    slots.push(slot.binding);
                }
                AddressSpace::Storage { access } => {
                    assert!(!access.contains(StorageAccess::STORE), "{}: draws read", self.stem);
                    let slot = var.binding.as_ref().expect("a buffer has a binding");
                    assert_eq!(slot.group, 0, "{}: one bind group", self.stem);
                    buffers.push(slot.binding);
                }
                other => panic!("{}: address space {other:?} is not used here", self.stem),
            }
        }
        let counts = (slots.len() as u32, buffers.len() as u32);
        slots.sort_unstable();
        buffers.sort_unstable();
        let is_dense = slots.into_iter().chain(buffers).eq(0..counts.0 + counts.1);
        assert!(is_dense, "{}: bindings are 0, 1, 2, …, images first", self.stem);
        counts
    }

    fn kernel_module(&self, most: &mut Most) -> String {
        let entry = match self.module.entry_points.as_slice() {
            [e] if e.name == "main" => e,
            _ => panic!("{}: a kernel has one entry point, `main`", self.stem),
        };
        let mut bindings = Vec::new();
        let mut params = String::new();
        let (mut params_size, mut shared_bytes) = (0, 0);
        for (handle, var) in self.module.global_variables.iter() {
            match var.space {
                AddressSpace::Storage { access } => {
                    let slot = var.binding.as_ref().unwrap_or_else(|| {
                        panic!("{}: `{:?}` has no binding", self.stem, var.name)
                    });
                    assert_eq!(slot.group, 0, "{}: one bind group", self.stem);
                    let name = var.name.clone().expect("named binding");
                    let TypeInner::Array { base, .. } = self.module.types[var.ty].inner else {
                        panic!("{}: `{name}` is not an array", self.stem)
                    };
                    let writable = access.contains(StorageAccess::STORE);
                    let read =
                        self.info.get_entry_point(0)[handle].contains(naga::valid::GlobalUse::READ);
                    bindings.push((slot.binding, name, self.rust_type(base), writable, read));
                }
                AddressSpace::Immediate => {
                    (params, params_size) = self.params(var.ty);
                }
                AddressSpace::WorkGroup => {
                    shared_bytes += self.module.types[var.ty].inner.size(self.module.to_ctx());
                }
                AddressSpace::Private => {}
                other => panic!("{}: address space {other:?} is not used here", self.stem),
            }
        }
        bindings.sort();
        for (i, b) in bindings.iter().enumerate() {
            assert_eq!(b.0 as usize, i, "{}: bindings are 0, 1, 2, …", self.stem);
        }
        let [wx, wy, wz] = entry.workgroup_size;
        assert_eq!((wy, wz), (1, 1), "{}: workgroups are one-dimensional", self.stem);
        most.workgroup = most.workgroup.max(wx);
        most.storage_buffers = most.storage_buffers.max(bindings.len() as u32);
        most.params_bytes = most.params_bytes.max(params_size);
        most.shared_bytes = most.shared_bytes.max(shared_bytes);

        let stem = &self.stem;
        let mut s = String::new();
        let mut list = String::new();
        let (mut fields, mut ids, mut slices, mut opens) =
            (String::new(), String::new(), String::new(), String::new());
        for (i, name, ty, writable, read) in &bindings {
            let _ = write!(
                list,
                "Binding {{ name: \"{name}\", writable: {writable}, read: {read} }}, "
            );
            let _ = write!(fields, "pub {name}: Buf<{ty}>, ");
            let _ = write!(ids, "self.{name}.id(), ");
            let (m, open) = if *writable { ("mut ", "write") } else { ("", "read") };
            let _ = write!(slices, "pub {name}: &'a {m}[{ty}], ");
            let _ = write!(opens, "{name}: args.{open}({i}), ");
        }
        if params.is_empty() {
            params = "#[repr(C)] #[derive(Clone, Copy, Debug, Default, bytemuck::Pod, \
                      bytemuck::Zeroable)] pub struct Params {}"
                .into();
        }
        let _ = writeln!(
            s,
            "pub mod {stem} {{
    use crate::compute::{{Binding, Buf, BufId, CpuArgs, Launch, Shader}};
    pub static SHADER: Shader = Shader {{
        name: \"{stem}\",
        spirv: include_bytes!(concat!(env!(\"OUT_DIR\"), \"/{stem}.spv\")),
        restricted: include_bytes!(concat!(env!(\"OUT_DIR\"), \"/{stem}_restricted.spv\")),
        workgroup: {wx},
        params_size: {params_size},
        bindings: &[{list}],
    }};
    {params}
    #[derive(Clone, Copy)] pub struct Bindings {{ {fields} }}
    impl Launch for Bindings {{
        type Params = Params;
        fn ids(&self) -> Vec<BufId> {{ vec![{ids}] }}
    }}
    /// What the CPU twin sees: the same bindings as slices.
    pub struct Slices<'a> {{ {slices} }}
    /// Opens a launch for the twin: slices, parameters, number of threads asked for.
    pub fn open<'a>(args: &'a mut CpuArgs<'_>) -> (Slices<'a>, Params, usize) {{
        let (params, threads) = (args.params(), args.threads());
        let mut args = args.slices();
        let _ = &mut args;
        (Slices {{ {opens} }}, params, threads)
    }}
}}"
        );
        s
    }

    /// The immediate struct as Rust, with explicit padding so that it is plain old data.
    fn params(&self, ty: naga::Handle<naga::Type>) -> (String, u32) {
        let TypeInner::Struct { ref members, span } = self.module.types[ty].inner else {
            panic!("{}: the immediate is a struct", self.stem)
        };
        assert!(span <= 128, "{}: immediates hold 128 bytes, this one {span}", self.stem);
        let mut s = String::from(
            "#[repr(C)] #[derive(Clone, Copy, Debug, Default, bytemuck::Pod, bytemuck::Zeroable)] \
             pub struct Params { ",
        );
        let (mut at, mut pads) = (0, 0);
        let mut pad = |s: &mut String, at: &mut u32, to: u32| {
            while *at < to {
                let _ = write!(s, "pub pad{pads}: u32, ");
                pads += 1;
                *at += 4;
            }
        };
        for m in members {
            pad(&mut s, &mut at, m.offset);
            let name = m.name.as_deref().expect("named member");
            let _ = write!(s, "pub {name}: {}, ", self.rust_type(m.ty));
            at = m.offset + self.module.types[m.ty].inner.size(self.module.to_ctx());
        }
        pad(&mut s, &mut at, span);
        (s + "}", span)
    }

    fn rust_type(&self, ty: naga::Handle<naga::Type>) -> String {
        let scalar = |s: naga::Scalar| match (s.kind, s.width) {
            (ScalarKind::Uint, 4) => "u32",
            (ScalarKind::Sint, 4) => "i32",
            (ScalarKind::Float, 4) => "f32",
            _ => panic!("{}: scalar {s:?} has no host type here", self.stem),
        };
        match self.module.types[ty].inner {
            TypeInner::Scalar(s) | TypeInner::Atomic(s) => scalar(s).to_owned(),
            TypeInner::Vector { size, scalar: s } => {
                let n = match size {
                    VectorSize::Bi => 2,
                    VectorSize::Tri => 3,
                    VectorSize::Quad => 4,
                };
                format!("[{}; {n}]", scalar(s))
            }
            TypeInner::Matrix { columns: VectorSize::Quad, rows: VectorSize::Quad, scalar: s } => {
                format!("[{}; 16]", scalar(s))
            }
            ref other => panic!("{}: {other:?} has no host type here", self.stem),
        }
    }
}

/// Rewrites access chains that begin at the result of another one to begin at its root. The
/// validation layer loses track of buffers behind nested chains, and with them of missing barriers
/// and accesses outside a buffer; what it validates is what is shipped.
fn joined_chains(words: &[u32]) -> Vec<u32> {
    const ACCESS_CHAIN: u32 = 65;
    let mut chains = BTreeMap::<u32, Vec<u32>>::new();
    let (header, mut rest) = words.split_at(5);
    let mut out = header.to_vec();
    while let Some(first) = rest.first() {
        let (instruction, after) = rest.split_at((first >> 16) as usize);
        rest = after;
        if let &[_, kind, result, base, ref indices @ ..] = instruction
            && first & 0xffff == ACCESS_CHAIN
        {
            let mut path = chains.get(&base).cloned().unwrap_or(vec![base]);
            path.extend(indices);
            out.push((3 + path.len() as u32) << 16 | ACCESS_CHAIN);
            out.extend([kind, result]);
            out.extend(&path);
            chains.insert(result, path);
        } else {
            out.extend(instruction);
        }
    }
    out
}

fn spirv_options(bounds: BoundsCheckPolicy) -> naga::back::spv::Options<'static> {
    use naga::back::spv::{Options, WriterFlags, ZeroInitializeWorkgroupMemoryMode};
    Options {
        lang_version: (1, 3),
        // ADJUST_COORDINATE_SPACE stays off: our projections are Vulkan's own.
        flags: WriterFlags::LABEL_VARYINGS,
        bounds_check_policies: BoundsCheckPolicies {
            index: bounds,
            buffer: bounds,
            image_load: BoundsCheckPolicy::Unchecked,
            binding_array: BoundsCheckPolicy::Unchecked,
        },
        zero_initialize_workgroup_memory: ZeroInitializeWorkgroupMemoryMode::None,
        force_loop_bounding: false,
        emit_int_div_checks: false,
        use_storage_input_output_16: false,
        ..Default::default()
    }
}

fn with_includes(path: &Path, seen: &mut BTreeSet<PathBuf>) -> String {
    let text = fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let mut out = String::new();
    for line in text.lines() {
        if let Some(name) = line.strip_prefix("#include \"").and_then(|l| l.strip_suffix('"')) {
            let file = Path::new("shaders").join(name);
            if seen.insert(file.clone()) {
                out += &with_includes(&file, seen);
            }
        } else {
            out += line;
            out.push('\n');
        }
    }
    out
}

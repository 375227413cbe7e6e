//! The fabrics that a scene may name as its material.

use super::{Mass, Moduli, Scene, Stiffness};
use crate::cloth::Weave;
use crate::{Error, Result};

/// A fabric to be had by its name: `"material": "denim"`, or [`Scene::set_fabric`]. Most were measured; rubber follows from its
/// density and shear modulus, and leather from its drape.
///
/// The moduli are those along warp and weft (wales and courses of a knit) at small strains and curvatures. Real fabrics stiffen when
/// they are stretched, soften or stiffen when they are bent, and keep some of both; none of that is in them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fabric {
    /// Its name.
    pub name: &'static str,
    /// What it is, in one line.
    pub description: &'static str,
    /// Mass per area [kg/m^2].
    pub areal_mass_kg_m2: f64,
    /// Its moduli.
    pub moduli: Moduli,
    /// Where the numbers come from.
    pub source: &'static str,
    /// The least and the greatest of its drape coefficients that were published, with 1 for a plate (Cusick 1968).
    pub published_drape_coefficients: Option<[f64; 2]>,
}

/// Ten fabrics that Wang, Ramamoorthi and O'Brien measured, from the database of their paper.
const WANG: &str = "H. Wang, R. Ramamoorthi, J. F. O'Brien, Data-Driven Elastic Models for Cloth: Modeling and Measurement, \
     ACM Trans. Graph. 30(4), 71, 2011, files of the Berkeley garment library";

/// A file of that database. `stretching` are C11, C22 and C33 [N/m] of its first row, that of no strain, which all directions
/// share; `bending` the first numbers [N m] of its rows for 0 and 90 degrees, those of no curvature.
///
/// The numbers mean what ARCSim, the simulator that they come with, does with them. Its energy per area is
/// `C11 e11^2 + C22 e22^2 + 2 C33 e12^2 + ..`, so the stretch moduli are 2 C11 and 2 C22, and the shear modulus, with
/// `e12 = gamma / 2`, is C33. The coupling C12 has no counterpart here. An edge of length l between triangles of the area A
/// together, bent by theta, has `k l^2 theta^2 / (8 A)`: a regular mesh that is bent to a cylinder has the stiffness k / 4.
const fn measured(
    name: &'static str,
    description: &'static str,
    areal_mass_kg_m2: f64,
    stretching: [f64; 3],
    bending: [f64; 2],
) -> Fabric {
    // The mean of both axes, and each as a factor of it.
    let (stretch, bend) = (stretching[0] + stretching[1], bending[0] + bending[1]);
    let moduli = Moduli {
        stretch_modulus: stretch,
        shear_modulus: stretching[2],
        bending_stiffness: bend / 8.0,
        weave: Weave {
            stretch: [2.0 * stretching[0] / stretch, 2.0 * stretching[1] / stretch],
            bend: [2.0 * bending[0] / bend, 2.0 * bending[1] / bend],
        },
    };
    let published_drape_coefficients = None;
    Fabric { name, description, areal_mass_kg_m2, moduli, source: WANG, published_drape_coefficients }
}

/// Moduli of cloths under tension \[Pa\], along warp, weft and at 45 degrees, and their thickness \[m\].
struct Tension {
    moduli: [f64; 3],
    thickness: f64,
}

// Penava et al. 2014, plain weaves of 150, 235 and 165 g/m^2, as the code of "Codimensional Incremental Potential Contact" (M. Li,
// D. M. Kaufman, C. Jiang 2021) lists them: the modulus at 45 degrees, and how many times more it has along the threads.
const OF_COTTON: Tension =
    Tension { moduli: [0.821e6 * 15.147, 0.821e6 * 39.658, 0.821e6], thickness: 0.318e-3 };
const OF_WOOL: Tension =
    Tension { moduli: [0.170e6 * 47.935, 0.170e6 * 128.588, 0.170e6], thickness: 0.568e-3 };
const OF_POLYESTER: Tension =
    Tension { moduli: [0.478e6 * 24.423, 0.478e6 * 10.778, 0.478e6], thickness: 0.252e-3 };

const MATSUDAIRA: &str = "M. Matsudaira, T. Masuda, M. Wada, H. Yokura, Shape Factor of Flared Skirts Compared with That of Circular Fabrics, \
     J. Text. Eng. 61(6), 69, 2015: mass, bending, drape coefficient; stretch and shear are those of another plain weave of the same fibre, \
     Z. Penava, D. Simic Penava, Z. Knezic, Determination of the Elastic Constants of Plain Woven Fabrics by a Tensile Test in Various \
     Directions, Fibres Text. East. Eur. 22(2), 57, 2014";

/// A fabric that bends with `bending` [gf cm^2/cm], the mean of both directions in Kawabata's test, with its published drape coefficient.
/// Tension at 45 degrees to the threads shears a cloth, so its modulus there, E, has `4 / E = 1 / E_warp + 1 / E_weft + 1 / G`, but for
/// Poisson's ratios, which are small beside the rest.
const fn draped(
    name: &'static str,
    description: &'static str,
    areal_mass_kg_m2: f64,
    bending: f64,
    Tension { moduli: [warp, weft, diagonal], thickness }: Tension,
    published: f64,
) -> Fabric {
    let stretch = (warp + weft) / 2.0;
    let moduli = Moduli {
        stretch_modulus: stretch * thickness,
        shear_modulus: thickness / (4.0 / diagonal - 1.0 / warp - 1.0 / weft),
        bending_stiffness: 9.80665e-5 * bending,
        weave: Weave { stretch: [warp / stretch, weft / stretch], bend: [1.0, 1.0] },
    };
    let published_drape_coefficients = Some([published, published]);
    Fabric { name, description, areal_mass_kg_m2, moduli, source: MATSUDAIRA, published_drape_coefficients }
}

const CLYDE: &str = "D. Clyde, J. Teran, R. Tamstorf, Modeling and Data-Driven Parameter Estimation for Woven Fabrics, SCA 2017: mass, \
     thickness and moduli at small strains; bends as a sheet of that thickness";

/// A fabric with the energy `a11 e11^2 / 2 + a12 e11 e22 + a22 e22^2 / 2 + G12 e12^2` per volume, and `[a11, a12, a22, G12]` in Pa. A strip
/// that is free to contract has Young's moduli `a11 - a12^2 / a22` and `a22 - a12^2 / a11`; bent to a cylinder the sheet has `a11 t^3 / 12`
/// and `a22 t^3 / 12`. Since e12 is half the angle of shear, the shear modulus is `G12 / 2`.
const fn orthotropic(
    name: &'static str,
    description: &'static str,
    areal_mass_kg_m2: f64,
    thickness_m: f64,
    [a11, a12, a22, g12]: [f64; 4],
) -> Fabric {
    let (warp, weft) = (a11 - a12 * a12 / a22, a22 - a12 * a12 / a11);
    let (stretch, bend) = ((warp + weft) / 2.0, (a11 + a22) / 2.0);
    let moduli = Moduli {
        stretch_modulus: stretch * thickness_m,
        shear_modulus: g12 / 2.0 * thickness_m,
        bending_stiffness: bend * thickness_m * thickness_m * thickness_m / 12.0,
        weave: Weave { stretch: [warp / stretch, weft / stretch], bend: [a11 / bend, a22 / bend] },
    };
    let published_drape_coefficients = None;
    Fabric { name, description, areal_mass_kg_m2, moduli, source: CLYDE, published_drape_coefficients }
}

const MATWEB: &str = "MatWeb, Natural Rubber, Vulcanized (NR, IR, Polyisoprene): density and shear modulus; as a sheet of half a \
     millimetre that keeps its volume";

/// A sheet of this thickness \[m\] of a material that is the same in all directions and keeps its volume when it is deformed, with a
/// density [kg/m^3] and a shear modulus G \[Pa\]. Then Young's modulus is 3 G and Poisson's ratio 1/2, so the sheet has the moduli
/// 3 G t and G t, and bends with `3 G t^3 / (12 (1 - 1/4)) = G t^3 / 3`.
const fn homogeneous(
    name: &'static str,
    description: &'static str,
    source: &'static str,
    thickness_m: f64,
    [density, shear]: [f64; 2],
) -> Fabric {
    let moduli = Moduli {
        stretch_modulus: 3.0 * shear * thickness_m,
        shear_modulus: shear * thickness_m,
        bending_stiffness: shear * thickness_m * thickness_m * thickness_m / 3.0,
        weave: Weave { stretch: [1.0, 1.0], bend: [1.0, 1.0] },
    };
    let published_drape_coefficients = None;
    let areal_mass_kg_m2 = density * thickness_m;
    Fabric { name, description, areal_mass_kg_m2, moduli, source, published_drape_coefficients }
}

const MEMON: &str = "H. Memon, E. B. Chaklie, H. M. Yesuf, C. Zhu, Study on Effect of Leather Rigidity and Thickness on Drapability of Sheep \
     Garment Leather, Materials 14(16), 4553, 2021: thickness and drape coefficient of four leathers, of which this is the middle; with the \
     density of furniture leather and, as a sheet of one material, the stiffness that drapes so";

// Names of the files are in brackets.
const ALL: &[Fabric] = &[
    // [gray-interlock]
    measured(
        "t-shirt",
        "interlock knit, 60 % cotton, 40 % polyester",
        0.187,
        [16.593832, 34.477123, 36.860302],
        [23.191698e-6, 14.267624e-6],
    ),
    // [ivory-rib-knit]
    measured(
        "rib-knit",
        "rib knit of underwear, 95 % cotton, 5 % spandex",
        0.276,
        [42.871021, 65.166023, 83.175644],
        [46.237591e-6, 32.243889e-6],
    ),
    // [11oz-black-denim]
    measured(
        "denim",
        "denim of jeans, 11 oz, 99 % cotton, 1 % spandex",
        0.324,
        [205.352005, 1013.88629, 53.387184],
        [64.196457e-6, 96.951576e-6],
    ),
    // [royal-target]
    measured(
        "trousers",
        "cloth of trousers, 65 % cotton, 35 % polyester",
        0.220,
        [2016.55456, 2034.97644, 104.759674],
        [125.409805e-6, 125.409805e-6],
    ),
    // [tango-red-jet-set]
    measured(
        "jacket",
        "light cloth of a jacket, polyester",
        0.113,
        [43.067627, 171.424835, 14.314700],
        [14.293814e-6, 20.345654e-6],
    ),
    // [camel-ponte-roma]
    measured(
        "ponte-roma",
        "ponte roma knit of a jacket, 60 % polyester, 40 % rayon",
        0.284,
        [31.146198, 44.028667, 31.896357],
        [36.348366e-6, 37.157593e-6],
    ),
    // [navy-sparkle-sweat]
    measured(
        "sweater",
        "knit of a sweater, 96 % polyester, 4 % spandex",
        0.224,
        [12.486332, 3.272434, 17.616289],
        [59.469658e-6, 45.625023e-6],
    ),
    // [white-swim-solid]
    measured(
        "swimsuit",
        "knit of a swimsuit, 87 % nylon, 13 % spandex",
        0.204,
        [47.971176, 104.615456, 60.773663],
        [60.237942e-6, 51.018833e-6],
    ),
    // [white-dots-on-blk]
    measured(
        "tablecloth",
        "light cloth of a table, polyester",
        0.128,
        [2002.08618, 2027.48559, 19.189022],
        [51.713814e-6, 31.282822e-6],
    ),
    // [pink-ribbon-brown]
    measured(
        "blanket",
        "cloth of a blanket, polyester",
        0.228,
        [151.503906, 244.830673, 30.250183],
        [117.070122e-6, 59.774277e-6],
    ),
    draped("cotton", "broadcloth, cotton", 0.1238, 0.118, OF_COTTON, 0.829),
    draped("wool", "tropical, light plain weave of suits, wool", 0.1629, 0.067, OF_WOOL, 0.498),
    draped(
        "polyester",
        "tropical, light plain weave of suits, polyester",
        0.1165,
        0.077,
        OF_POLYESTER,
        0.507,
    ),
    draped("faille", "faille, fine ribbed weave, polyester", 0.1043, 0.019, OF_POLYESTER, 0.283),
    orthotropic("silk", "charmeuse, satin weave, silk", 0.083, 0.18e-3, [4.3e6, 4.971e6, 9.942e6, 0.57e6]),
    orthotropic("canvas", "canvas, cotton", 0.294, 0.53e-3, [5.366e6, 2.683e6, 19.804e6, 2.009e6]),
    Fabric {
        published_drape_coefficients: Some([0.4735, 0.699]),
        ..homogeneous("leather", "sheep leather of garments, 0.8 mm", MEMON, 0.8e-3, [650.0, 0.24e6])
    },
    homogeneous("rubber", "sheet of vulcanised natural rubber, 0.5 mm", MATWEB, 0.5e-3, [950.0, 0.5e6]),
];

/// Returns the fabrics that a scene may name, each with a name of its own.
///
/// ```
/// use fnopt::scene::{Scene, fabrics};
///
/// let scene = Scene::parse(r#"{"material": "denim"}"#, "example", "".as_ref())?;
/// let denim = fabrics().iter().find(|fabric| fabric.name == "denim").unwrap();
/// assert_eq!((scene.stiffness, scene.mass), (denim.stiffness(), denim.mass()));
/// # Ok::<(), fnopt::Error>(())
/// ```
pub fn fabrics() -> &'static [Fabric] {
    ALL
}

impl Fabric {
    /// Returns the fabric called `name`; `origin` is the file or option that the name comes from. Fails with the nearest
    /// names if there is none.
    pub fn find(name: &str, origin: &str) -> Result<Self> {
        Self::known(name).ok_or_else(|| Error::unknown(origin, "fabric", name, ALL.iter().map(|f| f.name)))
    }

    /// Returns the fabric called `name`, if there is one.
    pub fn known(name: &str) -> Option<Self> {
        ALL.iter().find(|fabric| fabric.name == name).copied()
    }

    /// Returns its stiffness, for [`Scene::stiffness`].
    pub fn stiffness(&self) -> Stiffness {
        Stiffness::Moduli(self.moduli)
    }

    /// Returns its mass, for [`Scene::mass`].
    pub fn mass(&self) -> Mass {
        Mass::Areal(self.areal_mass_kg_m2)
    }
}

impl Scene {
    /// Makes the cloth one of the fabric called `name` ([`fabrics`]): its stiffness, and its mass per area. Fails, and changes nothing, if
    /// there is none.
    ///
    /// ```
    /// use fnopt::Scene;
    ///
    /// let mut scene = Scene::named("sphere")?;
    /// scene.set_fabric("denim")?;
    /// # Ok::<(), fnopt::Error>(())
    /// ```
    pub fn set_fabric(&mut self, name: &str) -> Result<()> {
        let fabric = Fabric::find(name, &self.origin)?;
        (self.stiffness, self.mass) = (fabric.stiffness(), fabric.mass());
        Ok(())
    }
}

impl Moduli {
    /// Returns the bending lengths `(D / (rho g))^(1/3)` \[m\], along the height and along the width, of a sheet with a mass per area rho [kg/m^2] under a gravity g
    /// [m/s^2] (F. T. Peirce, The "Handle" of Cloth as a Measurable Quantity, J. Text. Inst. 21, T377, 1930): half of the
    /// overhang at which a strip bends down by 41.5 degrees.
    pub fn bending_lengths_m(&self, areal_mass_kg_m2: f64, gravity_m_s2: f64) -> [f64; 2] {
        let length =
            |factor: f64| (factor * self.bending_stiffness / (areal_mass_kg_m2 * gravity_m_s2)).cbrt();
        self.weave.bend.map(length)
    }
}

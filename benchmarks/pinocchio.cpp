// Tips and the paper's index by Pinocchio, for blocks of samples; `eiwa bench` builds and calls it.
//
// A sample is a point u of the unit cube: q = lower + u * span, forward kinematics and joint Jacobian of the last joint,
// w = sqrt(det(J J^T)), times 1 - exp(-K prod u (1 - u)). Only headers are used: nothing is linked.
//
// computeJointJacobians(model, data, q) does the forward kinematics (data.oMi) and fills data.J, whose columns are
// expressed in the WORLD frame. A change of frame multiplies J by a matrix of determinant 1, so data.J gives the same w
// as the Jacobian at the tip, and is faster. For six joints w is |det J| by LU, else it comes from LDLT of J J^T.

#include <pinocchio/algorithm/jacobian.hpp>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>

#include <algorithm>
#include <cmath>
#include <string>

namespace
{

using Matrix6 = Eigen::Matrix<double, 6, 6>;
using Vector = Eigen::VectorXd;

struct Arm
{
  pinocchio::Model model;
  Vector lower, span;
  double K;
};

/// Fixed part of a modified (Craig) DH row, Rx(alpha) Tx(a) Tz(d) (Rz and Tz commute); rad and m.
pinocchio::SE3 placement(double alpha, double a, double d)
{
  const Eigen::Matrix3d rotation = Eigen::AngleAxisd(alpha, Eigen::Vector3d::UnitX()).toRotationMatrix();
  return pinocchio::SE3(rotation, rotation * Eigen::Vector3d(a, 0.0, d));
}

double manipulability(pinocchio::Data & data)
{
  if (data.J.cols() == 6)
  {
    Eigen::Map<Matrix6> jacobian(data.J.data());  // in place: the next sample fills it anew
    return std::abs(Eigen::PartialPivLU<Eigen::Ref<Matrix6>>(jacobian).determinant());
  }
  Matrix6 gram;
  gram.noalias() = data.J * data.J.transpose();
  return std::sqrt(std::max(0.0, Eigen::LDLT<Matrix6>(gram).vectorD().prod()));
}

}  // namespace

extern "C"
{
  /// `rows`: alpha [rad], a, d [m] of every joint; limits in rad.
  void * arm_open(int joints, const double * rows, const double * lower, const double * span, double K)
  {
    Arm * arm = new Arm;
    for (int j = 0; j < joints; ++j)
    {
      const pinocchio::SE3 T = placement(rows[3 * j], rows[3 * j + 1], rows[3 * j + 2]);
      arm->model.addJoint(
        static_cast<pinocchio::JointIndex>(j), pinocchio::JointModelRZ(), T, "joint" + std::to_string(j));
    }
    arm->lower = Eigen::Map<const Vector>(lower, joints);
    arm->span = Eigen::Map<const Vector>(span, joints);
    arm->K = K;
    return arm;
  }

  /// Tips (n, 3) [m] and indices (n) at points u (n, joints); may be called from several threads.
  void arm_evaluate(const void * handle, long n, const double * u, double * tips, double * indices)
  {
    const Arm & arm = *static_cast<const Arm *>(handle);
    pinocchio::Data data(arm.model);
    const Eigen::Index joints = arm.lower.size();
    Vector q(joints);
    for (long s = 0; s < n; ++s, u += joints, tips += 3)
    {
      const Eigen::Map<const Vector> point(u, joints);
      q = arm.lower + point.cwiseProduct(arm.span);
      pinocchio::computeJointJacobians(arm.model, data, q);
      Eigen::Map<Eigen::Vector3d>{tips} = data.oMi[static_cast<std::size_t>(joints)].translation();
      const double margin = (point.array() * (1.0 - point.array())).prod();
      indices[s] = manipulability(data) * -std::expm1(-arm.K * margin);
    }
  }
}
